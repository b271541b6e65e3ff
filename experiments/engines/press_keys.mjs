// node press_keys.mjs PACKAGES CHROMIUM ADDRESS REPEATS: presses keys on a page of `diffshadow view`, each while it rests.
//
// PACKAGES is a folder with playwright-core in its node_modules. Writes JSON: by what a key changes, the milliseconds
// from each press to the animation frame that shows the new picture.

import { createRequire } from "node:module";

const [packages, executablePath, address, repeats] = process.argv.slice(2);
const { chromium } = createRequire(`${packages}/`)("playwright-core");
const KEYS = {
  bias: ['[aria-label^="bias.constant"]', "ArrowRight"],
  camera: ["#picture", "ArrowRight"],
  light: ['[aria-label^="scene.light.azimuth"]', "ArrowRight"],
};
const LONGEST = 60000; // milliseconds from a key to its picture
const QUIET = 1200; // milliseconds without a new picture, after which the page rests

const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage"] });

// The reference has all its rays, and no picture comes any more.
async function rest(page) {
  let before = null, now = await page.evaluate(() => document.body.dataset.number);
  while (now === undefined || now !== before) {
    before = now;
    await page.waitForTimeout(QUIET);
    now = await page.evaluate(() => document.body.dataset.number);
  }
}

// Runs in the page, before the key is pressed.
function watch() {
  window.taken = new Promise((resolve) => {
    let pressed = null;
    addEventListener("keydown", ({ timeStamp }) => { pressed = timeStamp; }, { once: true, capture: true });
    new MutationObserver((changes, observer) => {
      if (pressed === null) return;
      observer.disconnect();
      requestAnimationFrame(() => resolve(performance.now() - pressed));
    }).observe(document.body, { attributeFilter: ["data-number"] });
  });
}

try {
  const page = await (await browser.newContext({ viewport: { width: 1100, height: 760 } })).newPage();
  await page.goto(address);
  const taken = {};
  for (const [change, [focus, key]] of Object.entries(KEYS)) {
    taken[change] = [];
    await rest(page);
    await page.focus(focus);
    // The first press only compiles what is still missing.
    for (let i = 0; i <= Number(repeats); i += 1) {
      await page.evaluate(watch);
      await page.keyboard.press(key);
      const late = page.waitForTimeout(LONGEST).then(() => null);
      const milliseconds = await Promise.race([page.evaluate(() => window.taken), late]);
      if (milliseconds === null) throw new Error(`no picture within a minute of ${key} on ${focus}`);
      if (i > 0) taken[change].push(milliseconds);
      await rest(page);
    }
  }
  process.stdout.write(JSON.stringify(taken));
} finally {
  await browser.close();
}
