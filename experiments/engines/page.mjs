// Runs in the browser: fetches the jobs, draws each with its engine, and sends the arrays back.

const KINDS = { float32: Float32Array, uint32: Uint32Array, int32: Int32Array, uint8: Uint8Array };

async function fetchArrays(value) {
  // Replaces each {"file", "dtype"} in a job by its typed array.
  if (Array.isArray(value)) return Promise.all(value.map(fetchArrays));
  if (value === null || typeof value !== "object") return value;
  if (value.file) return new KINDS[value.dtype](await (await fetch(`/job/${value.file}`)).arrayBuffer());
  const entries = Object.entries(value).map(async ([key, item]) => [key, await fetchArrays(item)]);
  return Object.fromEntries(await Promise.all(entries));
}

async function send(path, body) {
  const reply = await fetch(path, { method: "POST", body });
  if (!reply.ok) throw new Error(`${path}: ${await reply.text()}`);
}

async function drawJob(index, raw) {
  const start = performance.now();
  const engine = await import(`/${raw.engine}.mjs`);
  const job = await fetchArrays(raw);
  const arrays = {};
  const save = async (name, array, shape) => {
    arrays[name] ??= { file: `out_${index}_${name}.bin`, dtype: array.constructor.name.slice(0, -5).toLowerCase(), shape };
    await send(`/out/out_${index}_${name}.bin`, array);
  };
  const info = await engine.draw(job, save);
  return { arrays, info: { ...info, engine: raw.engine, version: engine.version, seconds: (performance.now() - start) / 1e3 } };
}

window.run = async (index) => {
  const jobs = await (await fetch("/job/jobs.json")).json();
  return drawJob(index, jobs[index]);
};
window.ready = true;
