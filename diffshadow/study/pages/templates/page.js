// The slider: two pictures of the page on top of each other. The left picture is clipped at a line that pointer and
// arrow keys move.
for (const slider of document.querySelectorAll(".slider")) {
  const pictures = [...document.querySelectorAll("img[data-name]")];
  const frames = slider.querySelector(".frames");
  const range = slider.querySelector("input");
  for (const side of ["left", "right"]) {
    const select = slider.querySelector(`select.${side}`);
    const image = slider.querySelector(`img.${side}`);
    const show = () => {
      const chosen = pictures[select.selectedIndex];
      image.src = chosen.src;
      image.alt = chosen.alt;
      // At most as tall as the window.
      frames.style.maxWidth = `calc(80vh * ${chosen.width / chosen.height || 1})`;
    };
    select.append(...pictures.map((picture) => new Option(picture.dataset.name)));
    select.selectedIndex = Math.max(pictures.findIndex((p) => p.dataset.name === slider.dataset[side]), 0);
    select.addEventListener("change", show);
    show();
  }
  range.addEventListener("input", () => frames.style.setProperty("--cut", `${range.value}%`));
  slider.hidden = pictures.length < 2;
}

// A button that copies the text beside it. A page opened as a file may lack the clipboard. The text is then selected
// and copied as with the keyboard.
for (const button of document.querySelectorAll("button.copy")) {
  const text = button.parentElement.querySelector("pre");
  const select = () => {
    getSelection().selectAllChildren(text);
    return document.execCommand("copy");
  };
  button.addEventListener("click", async () => {
    let isCopied = true;
    try {
      await navigator.clipboard.writeText(text.textContent);
    } catch {
      isCopied = select();
    }
    button.textContent = isCopied ? "Copied" : "Press Ctrl+C";
    setTimeout(() => (button.textContent = "Copy"), 2000);
  });
  button.hidden = false;
}

// A click on a picture, or the enter key, enlarges it to the window. Another click or the escape key closes it.
const zoom = document.body.appendChild(document.createElement("dialog"));
zoom.className = "zoom";
zoom.addEventListener("click", () => zoom.close());
for (const image of document.querySelectorAll("main img")) {
  if (image.closest(".frames")) continue;
  const show = () => {
    const large = new Image();
    large.src = image.src;
    large.alt = image.alt;
    const shape = image.naturalWidth / image.naturalHeight || 1;
    large.style.width = `min(94vw, calc(94vh * ${shape}))`;
    zoom.replaceChildren(large);
    zoom.showModal();
  };
  image.classList.add("zooms");
  image.tabIndex = 0;
  image.setAttribute("role", "button");
  image.title = "Zoom";
  image.addEventListener("click", show);
  image.addEventListener("keydown", (event) => event.key === "Enter" && show());
}

// Tables and plots that are wider than the page scroll in their own box, also with the keyboard. A hint says so.
const hint = (box) => {
  // The hint itself does not count.
  box.classList.remove("scrolls");
  if (box.scrollWidth <= box.clientWidth) return;
  box.classList.add("scrolls");
  box.tabIndex = 0;
};
const watched = new ResizeObserver((boxes) => boxes.forEach(({ target }) => hint(target)));
for (const box of document.querySelectorAll(".wide, .chart")) {
  hint(box);
  watched.observe(box);
}
for (const details of document.querySelectorAll("details")) {
  details.addEventListener("toggle", () => details.querySelectorAll(".wide, .chart").forEach(hint));
}
