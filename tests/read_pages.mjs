// node read_pages.mjs PACKAGES CHROMIUM PAGE...: looks at pages as readers have them.
//
// PACKAGES is a folder with playwright-core and axe-core in its node_modules. Each page is opened at several widths, in
// light and in dark, with all its details. Writes JSON: what axe-core finds wrong by WCAG's A and AA (`violations`),
// which pages scroll sideways (`wide`), which numbers are cut off (`clipped`), and what the page's first button to copy
// put on the clipboard, with the text beside it (`copies`).

import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const WIDTHS = [360, 800, 1280];
const RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"];

const [packages, executablePath, ...files] = process.argv.slice(2);
const require = createRequire(`${packages}/`);
const { chromium } = require("playwright-core");
const axe = require.resolve("axe-core/axe.min.js");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage"] });
const found = { violations: [], wide: [], clipped: [], copies: [] };

async function look(page, file, at) {
  await page.goto(pathToFileURL(file).href);
  await page.addScriptTag({ path: axe });
  await page.evaluate(() => document.querySelectorAll("details").forEach((each) => (each.open = true)));
  const { violations } = await page.evaluate((values) => axe.run({ runOnly: { type: "tag", values } }), RULES);
  for (const { id, nodes } of violations)
    found.violations.push({ ...at, id, nodes: nodes.map((node) => `${node.target.join(" ")}: ${node.failureSummary}`) });
  const width = await page.evaluate(() => document.documentElement.scrollWidth);
  if (width > at.width) found.wide.push({ ...at, scrollWidth: width });
  // A box that hides what is wider than itself cuts numbers off; one that scrolls does not.
  const clipped = await page.$$eval(".number, .result, .copy", (cells) =>
    cells
      .filter((cell) => {
        const { left, right } = cell.getBoundingClientRect();
        for (let box = cell.parentElement; box; box = box.parentElement) {
          const style = getComputedStyle(box);
          const edge = box.getBoundingClientRect();
          if (style.overflowX === "auto" || style.overflowX === "scroll") return false;
          if (style.overflowX === "hidden" && (right > edge.right + 1 || left < edge.left - 1)) return true;
        }
        return right > innerWidth + 1;
      })
      .map((cell) => cell.textContent),
  );
  if (clipped.length) found.clipped.push({ ...at, clipped });
}

try {
  for (const colorScheme of ["light", "dark"]) {
    const context = await browser.newContext({ colorScheme, permissions: ["clipboard-read", "clipboard-write"] });
    const page = await context.newPage();
    for (const width of WIDTHS) {
      await page.setViewportSize({ width, height: 900 });
      for (const file of files) await look(page, file, { file, width, colorScheme });
    }
    for (const file of colorScheme === "light" ? files : []) {
      await page.goto(pathToFileURL(file).href);
      const button = page.locator("button.copy").first();
      if (!(await button.count())) continue;
      await button.click();
      await page.waitForFunction(() => document.querySelector("button.copy").textContent === "Copied");
      const text = await button.evaluate((each) => each.parentElement.querySelector("pre").textContent);
      found.copies.push({ file, text, copied: await page.evaluate(() => navigator.clipboard.readText()) });
    }
    await context.close();
  }
  process.stdout.write(JSON.stringify(found));
} finally {
  await browser.close();
}
