// The slider: two of the page's pictures on top of each other. The left one is clipped at a cut, which pointer and
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
      // No taller than the window.
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
