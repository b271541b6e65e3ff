// node draw_shader_pages.mjs PACKAGES CHROMIUM FOLDER PAGE...: opens exported pages, and keeps what they draw.
//
// PACKAGES is a folder with playwright-core in its node_modules. Of page number i, the pictures i_0.png, of the first
// setting, and i_1.png, of the second, i_turned.png, after a drag, and i_page.png, the whole page, are written to FOLDER.
// Writes JSON, for each page: `requests`, the addresses of all requests but for the page itself; `errors`; `failure`, what
// the page says; `ms`, when the first picture was drawn and when the first with all pixels, in milliseconds from the start; `back`, whether the button
// brings the first view back.

import { writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [packages, executablePath, folder, ...files] = process.argv.slice(2);
const { chromium } = createRequire(`${packages}/`)("playwright-core");
const args = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox", "--disable-dev-shm-usage"];
const browser = await chromium.launch({ executablePath, args });
const found = [];
for (const [i, file] of files.entries()) {
  const page = await (await browser.newContext({ viewport: { width: 1280, height: 800 } })).newPage();
  const seen = { requests: [], errors: [], messages: [] };
  const address = pathToFileURL(file).href;
  page.on("request", (request) => { if (request.url() !== address && !request.url().startsWith("data:")) seen.requests.push(request.url()); });
  page.on("pageerror", (error) => seen.errors.push(error.message));
  page.on("console", (message) => seen.messages.push(message.text()));
  await page.goto(address);
  await page.waitForFunction(() => document.body.dataset.fullPicture || !document.getElementById("failure").hidden, null, { timeout: 120000 });
  seen.failure = await page.textContent("#failure");
  seen.ms = await page.evaluate(() => [document.body.dataset.firstPicture, document.body.dataset.fullPicture].map(Number));
  const picture = async () => {
    // Two frames later, and after the pause that follows a movement.
    await page.waitForTimeout(400);
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    return page.evaluate(() => document.getElementById("scene").toDataURL());
  };
  const keep = (name, uri) => writeFileSync(`${folder}/${i}_${name}.png`, Buffer.from(uri.split(",")[1], "base64"));
  if (!seen.failure) {
    await page.screenshot({ path: `${folder}/${i}_page.png` });
    const cuts = await page.$("#cut") ? [1, 0] : [0];
    for (const at of cuts) {
      if (cuts.length > 1) await page.$eval("#cut", (cut, value) => { cut.value = value; cut.dispatchEvent(new Event("input")); }, at * 1000);
      keep(cuts.length > 1 ? 1 - at : 0, await picture());
    }
    const before = await picture();
    const box = await page.locator("#scene").boundingBox();
    await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width / 2 + 60, box.y + box.height / 2 - 20, { steps: 4 });
    await page.mouse.up();
    await page.mouse.wheel(0, -200);
    const turned = await picture();
    keep("turned", turned);
    await page.click("#reset");
    seen.back = turned !== before && (await picture()) === before;
  }
  found.push(seen);
  await page.close();
}
await browser.close();
console.log(JSON.stringify(found));
