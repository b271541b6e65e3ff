// node drive_page.mjs PACKAGES CHROMIUM SCRIPT ADDRESS…: uses a page of `diffshadow view` as a person would.
//
// PACKAGES is a folder with playwright-core and axe-core in its node_modules. SCRIPT is the name of one of `scripts`.
// Writes JSON: what was seen, by name.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";

const [packages, executablePath, script, ...addresses] = process.argv.slice(2);
const [address] = addresses;
const require = createRequire(`${packages}/`);
const { chromium } = require("playwright-core");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage"] });
const seen = { requests: [], errors: [], violations: [] };
const FITTED = ["bias.constant", "filter.radius"];
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

const opened = async (where = address, context = null) => {
  const page = await (context ?? await browser.newContext({ viewport: { width: 1100, height: 760 } })).newPage();
  page.on("request", (request) => seen.requests.push(request.url()));
  page.on("pageerror", (error) => seen.errors.push(error.message));
  // Each picture that is shown: its figures.
  await page.addInitScript(() => {
    window.shown = [];
    const watch = () => new MutationObserver(() => window.shown.push(document.getElementById("figures").textContent))
      .observe(document.body, { attributeFilter: ["data-number"] });
    addEventListener("DOMContentLoaded", watch);
  });
  await page.goto(where);
  return page;
};
const saved = async (page) => {
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save")]);
  return readFileSync(await download.path(), "utf8");
};
const shown = (page) => page.evaluate(() => window.shown);
const value = async (page, key) => Number(await page.inputValue(`[id="field-${key}"]`));
const traced = (page, rays) => page.waitForFunction((enough) => document.getElementById("figures").textContent
  .endsWith(`against ${enough} rays per pixel`), rays, { timeout: 120000 });
const says = (page, id, what, timeout = 120000) => page.waitForFunction(([where, text]) =>
  document.getElementById(where).textContent.includes(text), [id, what], { timeout });
// A choice of the group of controls with a title; the first is the type.
const choose = (page, title, option) => page.locator("details", { has: page.locator("summary", { hasText: title }) })
  .locator("label.choice select").first().selectOption(option);
const seconds = () => Number((performance.now() / 1000).toFixed(2));

const scripts = { person, rest: resting, fit: fitting, look: looking, tune: tuning };

// What stands first, the search, the light in the picture, redo, everything in the picture, PNG, and an engine beside.
async function tuning() {
  const page = await opened();
  let number = await rest(page, 0);
  seen.first = await page.locator("#tune input[type=number]").evaluateAll((all) => all.map(({ id }) => id.replace("field-", "")));
  seen.folded = await page.locator("details:not([open]) .choice").evaluateAll((all) => all.map(({ dataset }) => dataset.words.split(" ")[0]));
  await page.fill("#search", "slope profile");
  seen.found = await page.locator(".number:visible, .choice:visible").allTextContents();
  await page.fill("#search", "");
  seen.openAfter = await page.isVisible("text=slope profile");
  const angles = async () => [await value(page, "scene.light.azimuth"), await value(page, "scene.light.elevation")];
  const lamp = () => page.locator("#lamp").boundingBox();
  seen.angles = [await angles()];
  const before = await lamp();
  const [x, y] = [before.x + 15, before.y + 15];
  await page.mouse.move(x, y);
  await page.mouse.down();
  await page.mouse.move(x + 30, y + 40, { steps: 5 });
  await page.mouse.up();
  const after = await lamp();
  seen.moved = [after.x - before.x, after.y - before.y];
  number = await rest(page, number);
  seen.angles.push(await angles());
  await page.click("#undo");
  seen.angles.push(await angles());
  await page.locator("body").press("Control+Shift+Z");
  seen.angles.push(await angles());
  await page.focus("#lamp");
  await page.keyboard.press("ArrowLeft");
  seen.angles.push(await angles());
  // Away from the scene, and back with one key.
  await page.focus("#picture");
  for (let i = 0; i < 12; i += 1) await page.keyboard.press("-");
  await page.waitForTimeout(600);
  number = await rest(page, number);
  seen.far = await pixels(page);
  await page.keyboard.press("f");
  await page.waitForTimeout(600);
  number = await rest(page, number);
  seen.framed = await pixels(page);
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#png")]);
  seen.png = [download.suggestedFilename(), readFileSync(await download.path()).subarray(0, 24).toString("hex")];
  await page.selectOption("#split", "three.js defaults");
  number = await rest(page, number);
  seen.beside = [await text(page, "before"), await page.isVisible("#divider")];
  seen.error = await text(page, "error");
}

// To the last ray; then nothing more. A bias keeps the reference.
async function resting() {
  const page = await opened();
  await page.waitForFunction(() => document.body.dataset.full === "true", null, { timeout: 120000 });
  const began = seconds();
  await traced(page, 64);
  seen.seconds = seconds() - began;
  await page.waitForTimeout(300);
  seen.figures = await shown(page);
  process.stderr.write("rest\n");
  await page.waitForTimeout(4000);
  seen.quiet = (await shown(page)).length - seen.figures.length;
  await page.focus('[aria-label^="bias.constant"]');
  for (let i = 0; i < 3; i += 1) await page.keyboard.press("ArrowRight");
  await page.waitForTimeout(1500);
  seen.biased = (await shown(page)).slice(seen.figures.length);
}

// Which numbers are fitted, a fit that is seen, another filter meanwhile, and its stop; in two pages.
async function fitting() {
  const page = await opened();
  await rest(page, 0);
  await page.locator('[id="field-bias.slope"]').fill("0.25");
  await page.locator('[id="field-bias.slope"]').press("Enter");
  await page.waitForTimeout(600);
  for (const key of FITTED) await page.uncheck(`[aria-label="Fit ${key}"]`);
  await page.click("#fit");
  await says(page, "error", "nothing is chosen to be fitted");
  await traced(page, 64);
  seen.refused = await text(page, "error");
  seen.unfitted = await saved(page);
  await page.click("#share");
  const other = await opened(page.url(), page.context());
  await rest(other, 0);
  await other.click("#fit");
  await says(other, "error", "nothing is chosen to be fitted");
  seen.linked = await value(other, "bias.slope");
  for (const key of FITTED) await page.check(`[aria-label="Fit ${key}"]`);
  await page.waitForTimeout(600);
  seen.before = await value(page, "bias.constant");
  await page.click("#fit");
  seen.cleared = await text(page, "error");
  await page.waitForFunction((before) => Number(document.getElementById("field-bias.constant").value) !== before,
    seen.before, { timeout: 120000 });
  await page.waitForSelector("#curve:visible");
  await says(other, "fit-note", "RMSE");
  seen.otherKept = await value(other, "bias.constant");
  // The sliders of another filter are not the fit's.
  await choose(page, "Filter", "pcf");
  await page.waitForFunction(() => document.querySelector('[id="field-filter.samples"]') === null, null, { timeout: 120000 });
  await type(page, "bias.constant", 3);
  await page.waitForTimeout(2500);
  seen.kept = await value(page, "bias.constant");
  seen.isRunning = await page.isEnabled("#stop");
  const began = seconds();
  await page.click("#stop");
  await says(page, "fit-note", "stopped");
  seen.stopped = seconds() - began;
  seen.otherNote = await text(other, "fit-note");
  // Back to the first filter: the values that the user has set stay.
  await page.click("#undo");
  await page.waitForTimeout(600);
  seen.undone = await value(page, "bias.constant");
  seen.error = await text(page, "error");
}

// Of each address: the first picture, another light and bias, all rays, silence, and another view.
async function looking() {
  seen.pages = [];
  for (const each of addresses) {
    const page = await opened(each), found = {};
    const all = async (number) => { await rest(page, number); await traced(page, 16); return rest(page, number); };
    let number = await all(0);
    found.started = (await pixels(page)).mean;
    await page.locator('input[type=range][aria-label*="elevation"], input[type=range][aria-label*="position.1"]').first().focus();
    for (let i = 0; i < 5; i += 1) await page.keyboard.press("ArrowLeft");
    number = await all(number);
    found.lit = (await pixels(page)).mean;
    await type(page, "bias.constant", 2.25);
    number = await all(number);
    await page.waitForTimeout(200);
    const count = (await shown(page)).length;
    await page.waitForTimeout(800);
    found.quiet = (await shown(page)).length - count;
    found.views = await page.locator("#view option").allTextContents();
    await page.selectOption("#view", found.views.at(-1));
    await rest(page, number);
    found.viewed = (await pixels(page)).mean;
    seen.pages.push(found);
  }
}

async function person() {
  const page = await opened();
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

  seen.saved = await saved(page);
  await page.click("#command");
  await page.waitForFunction(() => document.body.dataset.copied?.startsWith("diffshadow render"));
  seen.command = await page.evaluate(() => document.body.dataset.copied);

  // Another page with the same settings, by its address.
  await page.click("#share");
  const other = await page.context().newPage();
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
  // A fit is one step.
  await page.click("#undo");
  seen.unfitted = await value(page, "bias.constant");

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
}

try {
  await scripts[script]();
  for (const page of browser.contexts().flatMap((context) => context.pages())) seen.lasting = (seen.lasting ?? "") + await text(page, "error");
  process.stdout.write(JSON.stringify(seen));
} finally {
  await browser.close();
}
