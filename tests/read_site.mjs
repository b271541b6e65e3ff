// node read_site.mjs PACKAGES CHROMIUM ADDRESS WORDS: searches the site for WORDS and follows the first hit.
//
// PACKAGES is a folder with playwright-core in its node_modules. Writes JSON: the `address` that the hit led to, the
// `names` that have documentation there, and the addresses of all `requests` on the way.

import { createRequire } from "node:module";

const [packages, executablePath, address, words] = process.argv.slice(2);
const { chromium } = createRequire(`${packages}/`)("playwright-core");
const browser = await chromium.launch({ executablePath, args: ["--no-sandbox", "--disable-dev-shm-usage"] });
try {
  const page = await browser.newPage();
  const requests = [];
  page.on("request", (request) => requests.push(request.url()));
  await page.goto(address);
  await page.click(".md-search__input");
  await page.keyboard.type(words);
  await page.click(".md-search-result__link");
  await page.waitForURL((url) => url.pathname !== "/", { timeout: 60000 });
  const names = await page.$$eval(".doc-heading", (headings) => headings.map((heading) => heading.id));
  process.stdout.write(JSON.stringify({ address: page.url(), names, requests }));
} finally {
  await browser.close();
}
