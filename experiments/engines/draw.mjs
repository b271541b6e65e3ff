// node draw.mjs FOLDER: draws the jobs of FOLDER/jobs.json in a headless Chromium.
//
// Arrays lie beside jobs.json as raw files, and the results are written there: raw files, and results.json.
// `engines.py` writes the folder and reads it back; it says what a job holds.

import { appendFile, readFile, writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { createRequire } from "node:module";
import path from "node:path";

const HERE = import.meta.dirname;
// Where the packages are, if not beside this file.
const PACKAGES = process.env.NODE_ROOT ?? HERE;
const { chromium } = createRequire(path.join(PACKAGES, "node_modules", "x.js"))("playwright-core");
const TYPES = { ".html": "text/html", ".mjs": "text/javascript", ".js": "text/javascript", ".json": "application/json" };
const FLAGS = [
  // The software rasterizer, so that every machine draws the same bits.
  "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
  // A closed network: nothing is looked up or updated.
  "--disable-background-networking", "--disable-component-update", "--disable-sync", "--no-first-run", "--disable-quic",
  "--no-sandbox", "--disable-dev-shm-usage",
];

function inside(folder, name) {
  const found = path.resolve(folder, name);
  if (!found.startsWith(path.resolve(folder) + path.sep)) throw new Error(`${name} lies outside of what is served`);
  return found;
}

function serve(folder) {
  const server = createServer(async (request, response) => {
    try {
      const name = decodeURIComponent(new URL(request.url, "http://localhost").pathname).slice(1);
      if (request.method === "POST") {
        const parts = [];
        for await (const part of request) parts.push(part);
        await appendFile(inside(folder, name.replace(/^out\//, "")), Buffer.concat(parts));
        response.end();
        return;
      }
      const file = name.startsWith("job/") ? inside(folder, name.slice(4))
        : inside(name.startsWith("node_modules/") ? PACKAGES : HERE, name);
      const body = await readFile(file);
      response.writeHead(200, { "Content-Type": TYPES[path.extname(file)] ?? "application/octet-stream" });
      response.end(body);
    } catch (error) {
      response.writeHead(error.code === "ENOENT" ? 404 : 500);
      response.end(String(error));
    }
  });
  return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server)));
}

async function main(folder, executablePath) {
  const jobs = JSON.parse(await readFile(path.join(folder, "jobs.json"), "utf8"));
  const server = await serve(folder);
  const profile = path.join(folder, "profile");
  const context = await chromium.launchPersistentContext(profile, { executablePath, headless: true, args: FLAGS });
  try {
    const results = [];
    let page = null;
    let messages = [];
    for (const [index, job] of jobs.entries()) {
      // One page per engine: a module is loaded once, and no engine sees what another left behind.
      if (index === 0 || jobs[index - 1].engine !== job.engine) {
        await page?.close();
        page = await context.newPage();
        page.on("console", (message) => {
          // Chromium's advice about speed is nothing that an engine says, and a log has the time of day.
          if (message.type() === "log" || message.text().includes("GL Driver Message")) return;
          messages.push(`${message.type()}: ${message.text()}`);
        });
        page.on("pageerror", (error) => messages.push(`error: ${error.message}`));
        await page.goto(`http://127.0.0.1:${server.address().port}/page.html`);
        await page.waitForFunction(() => window.ready, null, { timeout: 120000 });
      }
      messages = [];
      try {
        results.push({ ...(await page.evaluate((i) => window.run(i), index)), messages });
      } catch (error) {
        const [what] = error.message.replace(/^page\.evaluate: (Error: )?/, "").split("\n    at ");
        throw new Error([`job ${job.index} (${job.engine}): ${what}`, ...messages].join("\n"));
      }
      process.stdout.write(`${index + 1}/${jobs.length}\n`);
    }
    await writeFile(path.join(folder, "results.json"), JSON.stringify(results));
  } finally {
    await context.close();
    server.close();
  }
}

try {
  await main(process.argv[2], process.argv[3]);
} catch (error) {
  process.stderr.write(`${error.message}\n`);
  process.exitCode = 1;
}
