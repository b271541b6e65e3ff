// node drive_page.mjs PACKAGES CHROMIUM ADDRESS: uses a page of `diffshadow view` as a person would.
//
// PACKAGES is a folder with playwright-core and axe-core in its node_modules. Writes JSON: what was seen, by name.

import { createRequire } from "node:module";

const [packages, executablePath, address] = process.argv.slice(2);
const require = createRequire(`${packages}/`);
const { chromium } = require("playwright-core");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage"] });
const seen = { requests: [], errors: [], violations: [] };
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"];

const text = (page, id) => page.textContent(`#${id}`);
// A full picture with figures, of the newest settings.
const rest = async (page, number) => {
  await page.waitForFunction((least) => document.body.dataset.full === "true" && Number(document.body.dataset.number) > least &&
    /RMSE/.test(document.getElementById("figures").textContent), number, { timeout: 120000 });
  return Number(await page.evaluate(() => document.body.dataset.number));
};
// The mean of the canvas, and the middle of what is dark on its lower half, from 0 to 1.
const pixels = (page) => page.evaluate(() => {
  const canvas = document.getElementById("picture"), { width, height } = canvas;
  const { data } = canvas.getContext("2d").getImageData(0, 0, width, height);
  let sum = 0, dark = 0, across = 0;
  for (let i = 0; i < data.length; i += 4) {
    const grey = (data[i] + data[i + 1] + data[i + 2]) / 3;
    sum += grey;
    if (grey < 150 && i / 4 / width > height / 2) { dark += 1; across += (i / 4) % width; }
  }
  return { mean: sum / (data.length / 4), dark: dark / (width * height), across: across / dark / width };
});
const type = async (page, key, value) => {
  const field = page.locator(`[id="field-${key}"]`);
  await field.fill(String(value));
  await field.press("Enter");
};

try {
  const context = await browser.newContext({ viewport: { width: 1100, height: 760 } });
  const page = await context.newPage();
  page.on("request", (request) => seen.requests.push(request.url()));
  page.on("pageerror", (error) => seen.errors.push(error.message));
  await page.goto(address);
  let number = await rest(page, 0);
  await type(page, "bias.slope", 0);
  await type(page, "bias.constant", 0);
  number = await rest(page, number);
  await page.waitForTimeout(1500);
  seen.acne = await pixels(page);
  await type(page, "bias.constant", 2);
  await page.waitForTimeout(1500);
  seen.biased = await pixels(page);
  await type(page, "scene.light.azimuth", 60);
  await page.waitForTimeout(2500);
  seen.turned = await pixels(page);
  await page.click("#undo");
  await page.waitForTimeout(1500);
  seen.undone = await pixels(page);

  // By keys alone: the camera, and the slider of the bias.
  await page.focus("#picture");
  for (let i = 0; i < 4; i += 1) await page.keyboard.press("ArrowLeft");
  await page.waitForTimeout(1500);
  seen.orbited = await pixels(page);
  await page.focus('[aria-label^="bias.constant"]');
  await page.keyboard.press("ArrowRight");
  await page.waitForTimeout(500);
  seen.keyed = Number(await page.inputValue('[id="field-bias.constant"]'));

  await page.click("#fit");
  await page.waitForFunction(() => /reduced|moved|error/.test(document.getElementById("fit-note").textContent), null, { timeout: 120000 });
  seen.fit = await text(page, "fit-note");
  seen.curve = await page.isVisible("#curve");
  seen.fitted = Number(await page.inputValue('[id="field-bias.constant"]'));

  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save")]);
  seen.saved = await download.path().then((path) => import("node:fs").then(({ readFileSync }) => readFileSync(path, "utf8")));
  await page.click("#command");
  await page.waitForFunction(() => document.body.dataset.copied?.startsWith("diffshadow render"));
  seen.command = await page.evaluate(() => document.body.dataset.copied);

  // Another page with the same settings, by its address.
  await page.click("#share");
  const other = await context.newPage();
  await other.setViewportSize({ width: 380, height: 700 });
  await other.goto(page.url());
  await rest(other, 0);
  seen.shared = Number(await other.inputValue('[id="field-bias.constant"]'));
  seen.widths = [];
  for (const width of [380, 800, 1280]) {
    await other.setViewportSize({ width, height: 700 });
    seen.widths.push(await other.evaluate(() => document.documentElement.scrollWidth - innerWidth));
  }
  await other.close();

  // What axe-core finds wrong, in both themes, with all controls shown.
  for (const colorScheme of ["light", "dark"]) {
    const judged = await (await browser.newContext({ colorScheme, bypassCSP: true })).newPage();
    await judged.goto(address);
    await rest(judged, 0);
    await judged.$$eval("details", (all) => all.forEach((each) => { each.open = true; }));
    await judged.addScriptTag({ path: require.resolve("axe-core/axe.min.js") });
    const { violations } = await judged.evaluate((values) => axe.run({ runOnly: { type: "tag", values } }), RULES);
    seen.violations.push(...violations.map(({ id, nodes }) => `${colorScheme}: ${id}: ${nodes[0].html}`));
  }
  seen.lasting = await text(page, "error");
  process.stdout.write(JSON.stringify(seen));
} finally {
  await browser.close();
}
