// The page of `diffshadow view`. Its state is a list of settings, as in KEY=VALUE on the command line; the server draws
// what it asks for, one picture at a time. Plain JavaScript, served as it is.

const $ = (id) => document.getElementById(id);
const picture = $("picture"), context = picture.getContext("2d");
const PAUSE = 400; // milliseconds without a change after which an undo step ends
const SUN_AT = [1.3, 1, 0.7, 0.5]; // distances from the first mesh's centre, in its radii: the first inside the picture is used
const TURN = 0.4, KEY_TURN = 4, KEY_ZOOM = 1.08; // degrees per pixel, degrees per key press, factor per key press

const blank = () => ({ scene: null, structure: {}, numbers: {}, camera: null, fitted: null });
let look = { state: blank(), view: "shaded", light: 0, split: false };
let controls = null, images = null;
const rows = new Map(); // by key: the function that sets a slider's value
const done = [], undone = []; // steps of undo and redo
let settled = JSON.stringify(look), pause = 0;

// --- Connection ---

let socket = null;

function connect() {
  socket = new WebSocket(`ws://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { say("note", ""); send({ look }); };
  socket.onclose = () => { say("note", "diffshadow view has ended, or cannot be reached; this page tries again"); setTimeout(connect, 1000); };
  socket.onmessage = ({ data }) => typeof data === "string" ? hear(JSON.parse(data)) : show(data);
}

const send = (message) => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };
const ask = () => { say("error", ""); send({ look }); };
const say = (id, text) => { $(id).textContent = text; };

function hear(message) {
  if ("error" in message) { say("error", message.error); say("note", ""); }
  if ("note" in message) say("note", message.note);
  if ("controls" in message) build(message.controls);
  if ("saved" in message) saved(message.saved);
  if (message.started) { ownFit = message.started; fittedOf = structure(); }
  if ("code" in message) copy(message.code, "Copied the code");
  if ("picture" in message) savePicture(message.picture);
  if ("fit" in message) followFit(message.fit);
}

// --- Pictures ---

async function show(data) {
  const length = new DataView(data).getUint32(0);
  const about = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  images = { bitmap: await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" })), about };
  paint();
  send({ shown: about.number });
  fill($("view"), about.views.includes(look.view) ? about.views : [look.view, ...about.views], look.view);
  say("figures", sentence(about));
  // These figures belong to the previous picture until this picture is at rest.
  $("figures").classList.toggle("old", !about.is_full);
  say("note", `${about.size[1]} × ${about.size[0]} pixels in ${about.milliseconds} ms`);
  document.body.dataset.full = about.is_full; // for tests
  document.body.dataset.number = about.number;
}

function paint() {
  const { bitmap, about } = images, tall = about.split ? bitmap.height / 2 : bitmap.height;
  if (picture.width !== bitmap.width || picture.height !== tall) { picture.width = bitmap.width; picture.height = tall; }
  context.drawImage(bitmap, 0, 0);
  for (const id of ["divider", "before", "after"]) $(id).hidden = !about.split;
  say("before", about.split === true ? "before" : `${about.split} defaults`);
  placeLamp();
  if (!about.split) return;
  const at = Math.round($("divider").value * bitmap.width);
  context.drawImage(bitmap, 0, tall, at, tall, 0, 0, at, tall);
  context.fillStyle = "#fff";
  context.fillRect(at - 1, 0, 2, tall);
}

function sentence({ figures, rays, is_full, view, untraced }) {
  // The figures still use the old reference. They are updated at rest.
  if (!is_full) return rays ? $("figures").textContent : "";
  if (untraced) return untraced;
  const waits = view !== look.view ? `; ${look.view} follows` : "";
  if (!rays) return `tracing the reference${waits}`;
  if (!("rmse" in figures)) return "no pixel counts under this light";
  const percent = (value) => `${(100 * value).toPrecision(3)} %`;
  return `RMSE ${figures.rmse.toFixed(4)} · false shadow ${percent(figures.false_shadow_rate)} · ` +
    `false light ${percent(figures.false_light_rate)} · against ${rays} ${rays === 1 ? "ray" : "rays"} per pixel`;
}

// --- Settings ---

function change(edit) {
  edit(look.state);
  ask();
  clearTimeout(pause);
  pause = setTimeout(() => settle(), PAUSE);
  mark();
}

// A fit is one undo step, which is complete when the fit ends.
function settle(evenInFit = false) {
  const now = JSON.stringify(look);
  if (now === settled || (isFitting && !evenInFit)) return;
  done.push(settled);
  settled = now;
  undone.length = 0;
  buttons();
  history.replaceState(null, "", `#${encodeURIComponent(now)}`);
}

function adopt(text) {
  const found = JSON.parse(text);
  look = { ...look, ...found, state: { ...blank(), ...found.state } };
  settled = JSON.stringify(look);
  refresh();
  ask();
}

const undo = () => step(done, undone);
const redo = () => step(undone, done);

// Takes the last step of `from`, and adds the present settings to `to`.
function step(from, to) {
  clearTimeout(pause);
  settle();
  if (!from.length) return;
  to.push(settled);
  adopt(from.pop());
  history.replaceState(null, "", `#${encodeURIComponent(settled)}`);
  buttons();
}

function buttons() {
  $("undo").disabled = !done.length;
  $("redo").disabled = !undone.length;
}

// Sets all controls to the values of the state.
function refresh() {
  for (const [key, { set, slider }] of rows) set(look.state.numbers[key] ?? slider.value);
  $("split").value = look.split === true ? OWN : look.split ? `${look.split} defaults` : NOTHING;
  mark();
}

// Marks the numbers that differ from the configuration's, and shows the position of the sun.
function mark() {
  for (const [key, { row, slider }] of rows) row.classList.toggle("changed", (look.state.numbers[key] ?? slider.value) !== slider.value);
  placeLamp();
  const [azimuth, elevation] = sunKeys().map((key) => value(key));
  if (azimuth === undefined) return;
  const radius = (90 - elevation) / 90, angle = azimuth * Math.PI / 180;
  $("sun").setAttribute("cx", radius * Math.sin(angle));
  $("sun").setAttribute("cy", radius * Math.cos(angle));
}

const value = (key) => look.state.numbers[key] ?? rows.get(key)?.slider.value;

// --- Controls, made from the server's description of the configuration ---

// The settings that most people change come first, in this order.
const TUNED = [/^bias\.(constant|slope|normal_offset)$/, /^technique\.(constant_|slope_|normal_)?bias$/, /^(filter|technique)\.radius$/,
  /^scene\.lights?\..*(azimuth|elevation)$/, /^scene\.lights?\.(\d+\.)?position\./];
// Choices that are always visible.
const MAIN = /(^technique|^filter|^scene\.lights?(\.\d+)?)\.type$|^shadow_map\.resolution$|^filter\.samples$/;
const GROUPS = [["technique", "Technique", true], ["filter", "Filter", true], ["shadow_map", "Shadow map", true],
  ["scene.light", "Light", true], ["bias", "Bias", false], ["compare", "Compare", false],
  ["scene.camera", "Camera", false], ["scene.meshes", "Meshes", false], ["shading", "Shading", false]];
const NOTHING = "nothing", OWN = "own settings";

function build(given) {
  controls = given;
  document.title = `${given.name} – diffshadow`;
  const { numbers } = look.state;
  // Removes numbers that this technique does not have.
  const own = new Map(given.sliders.map((slider) => [slider.key, slider]));
  for (const key of Object.keys(numbers)) {
    if (own.has(key)) numbers[key] = Math.min(Math.max(numbers[key], own.get(key).low), own.get(key).high);
    else delete numbers[key];
  }
  rows.clear();
  const tuned = TUNED.flatMap((pattern) => given.sliders.filter(({ key }) => pattern.test(key)));
  $("tune").replaceChildren(...tuned.map((slider) => number(slider, slider.key.startsWith("scene.") ? "scene" : "")));
  const groups = GROUPS.map(([prefix, title, open]) => {
    const own = ({ key }) => key.startsWith(prefix);
    const [main, others] = [true, false].map((is) => given.pickers.filter((picker) => own(picker) && MAIN.test(picker.key) === is));
    const sliders = given.sliders.filter((slider) => own(slider) && !tuned.includes(slider));
    const shown = [...main.map((picker) => choice(picker, prefix)), ...sliders.map((slider) => number(slider, prefix))];
    const folded = others.map((picker) => choice(picker, prefix));
    if (!shown.length) return group(title, open, folded);
    return group(title, open, folded.length ? [...shown, group("more", false, folded, "more")] : shown);
  });
  $("controls").replaceChildren(...groups.filter((made) => made.children.length > 1));
  fill($("split"), [NOTHING, OWN, ...given.engines.map((engine) => `${engine} defaults`)], null);
  find();
  fill($("light"), given.lights.map((name) => name.replace("scene.", "")), null);
  $("light").selectedIndex = Math.min(look.light, given.lights.length - 1);
  $("light-label").hidden = given.lights.length < 2;
  fill($("scene"), ["own scene", ...given.scenes], look.state.scene ?? "own scene");
  $("scene-label").hidden = !given.scenes.length;
  $("sky-figure").hidden = !sunKeys().length;
  refresh();
  // The first values were used unchanged; the sliders may have moved since.
  showFit(given.fit);
}

const group = (title, open, parts, className = "") => {
  const made = element("details", "", { open, className });
  made.append(element("summary", title), ...parts);
  return made;
};

// Shows only the settings whose name or description contains the search words.
function find() {
  const words = $("search").value.toLowerCase().split(/[\s._]+/).filter(Boolean);
  const all = document.querySelectorAll("#tune .number, #controls .number, #controls .choice");
  for (const row of all) row.classList.toggle("unfound", !words.every((word) => row.dataset.words.includes(word)));
  for (const made of document.querySelectorAll("#controls details")) {
    made.classList.toggle("unfound", words.length > 0 && !made.querySelector(".number:not(.unfound), .choice:not(.unfound)"));
    // Groups that were folded before the search fold again.
    made.dataset.was ??= made.open;
    made.open = words.length > 0 || made.dataset.was === "true";
    if (!words.length) delete made.dataset.was;
  }
}

const element = (tag, text, of = {}) => Object.assign(document.createElement(tag), { textContent: text }, of);
// The short name of a light's setting: "2.azimuth" for the third of several lights, "azimuth" for a single light.
const short = (key, prefix) => key.slice(prefix.length).replace(/^s?\./, "") || key;

function fill(select, options, chosen) {
  if (select.dataset.options !== String(options)) {
    select.replaceChildren(...options.map((option) => element("option", option)));
    select.dataset.options = options;
  }
  if (chosen !== null) select.value = chosen;
}

function number(slider, prefix) {
  const row = element("div", "", { className: "number", title: slider.hint });
  row.dataset.words = `${slider.key} ${slider.hint}`.toLowerCase();
  const name = element("label", short(slider.key, prefix).replaceAll(/[._]/g, " "), { className: "name" });
  if (slider.unit) name.append(element("span", ` [${slider.unit}]`, { className: "unit" }));
  const range = element("input", "", { type: "range", min: slider.low, max: slider.high, step: "any", value: slider.value });
  const field = element("input", "", { type: "number", min: slider.low, max: slider.high, step: "any", value: slider.value });
  range.setAttribute("aria-label", `${slider.key} [${slider.unit}]`);
  field.id = `field-${slider.key}`;
  name.htmlFor = field.id;
  const again = element("button", "↺", { className: "again", title: `Back to ${slider.value}` });
  again.setAttribute("aria-label", `Reset ${slider.key}`);
  const set = (to) => { range.value = to; field.value = Number(Number(to).toPrecision(6)); };
  const put = (to) => { set(to); change(({ numbers }) => { if (to === slider.value) delete numbers[slider.key]; else numbers[slider.key] = to; }); };
  range.oninput = () => put(Number(Number(range.value).toPrecision(6)));
  field.onchange = () => put(Math.min(Math.max(Number(field.value), slider.low), slider.high));
  again.onclick = () => put(slider.value);
  const fit = element("label", "", { className: "fit", title: "whether a fit finds it" });
  if (slider.is_fittable || controls.fitted.includes(slider.key)) {
    const box = element("input", "", { type: "checkbox", checked: fitted().includes(slider.key) });
    box.setAttribute("aria-label", `Fit ${slider.key}`);
    box.onchange = () => change((state) => {
      state.fitted = box.checked ? [...fitted(), slider.key] : fitted().filter((key) => key !== slider.key);
    });
    fit.append(box, "fit");
  }
  row.append(name, fit, field, again, range);
  rows.set(slider.key, { set: (to) => { set(to); }, slider, row });
  return row;
}

const fitted = () => look.state.fitted ?? controls.fitted;

function choice(picker, prefix) {
  const row = element("label", short(picker.key, prefix).replaceAll("_", " "), { className: "choice", title: picker.hint });
  row.dataset.words = `${picker.key} ${picker.hint}`.toLowerCase();
  const labels = picker.options.map(([label]) => label);
  const field = labels.length ? element("select", "") : element("input", "", { type: "number", min: picker.low, max: picker.high, value: picker.value });
  if (labels.length) {
    const is = (option) => JSON.stringify(option) === JSON.stringify(picker.value) || option?.type === picker.value;
    const at = picker.options.findIndex(([, option]) => is(option));
    fill(field, at < 0 ? ["default", ...labels] : labels, at < 0 ? "default" : labels[at]);
  }
  field.onchange = () => change((state) => {
    const to = labels.length ? picker.options.find(([label]) => label === field.value)?.[1] : Number(field.value);
    const section = picker.sets + ".";
    if (picker.sets !== picker.key) {
      // A new section keeps the numbers that it also has.
      for (const { key, value: own } of controls.sliders) if (key.startsWith(section)) state.numbers[key] ??= own;
      for (const key of Object.keys(state.structure)) if (key.startsWith(section)) delete state.structure[key];
    }
    delete state.structure[picker.sets];
    if (to !== undefined) state.structure[picker.sets] = to;
  });
  row.append(field);
  return row;
}

// --- The camera ---

const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
const dot = (a, b) => a.reduce((sum, x, i) => sum + x * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((x) => x / Math.hypot(...a));
const round = (point) => point.map((x) => Number(x.toPrecision(8)));
const turned = (a, axis, angle) => add(add(a.map((x) => x * Math.cos(angle)), cross(axis, a), Math.sin(angle)),
  axis, dot(axis, a) * (1 - Math.cos(angle)));

function move(edit) {
  if (!controls) return;
  change((state) => {
    const camera = structuredClone(state.camera ?? controls.camera);
    const up = unit(controls.up), away = add(camera.eye, camera.target, -1);
    edit(camera, away, up, unit(cross(up, away)));
    camera.eye = round(camera.eye);
    camera.target = round(camera.target);
    state.camera = camera;
  });
}

const orbit = (across, upward) => move((camera, away, up, right) => {
  const elevation = Math.asin(dot(unit(away), up)) * 180 / Math.PI;
  const rise = Math.min(Math.max(elevation + upward, -89), 89) - elevation;
  camera.eye = add(camera.target, turned(turned(away, right, -rise * Math.PI / 180), up, -across * Math.PI / 180));
});

// In fractions of the image's height.
const pan = (across, upward) => move((camera, away, up, right) => {
  const tall = camera.height ?? 2 * Math.hypot(...away) * Math.tan((value("scene.camera.fov_y") ?? 40) * Math.PI / 360);
  const shift = add(right.map((x) => x * -across * tall), unit(cross(away, right)), -upward * tall);
  camera.eye = add(camera.eye, shift);
  camera.target = add(camera.target, shift);
});

const zoom = (factor) => move((camera, away) => {
  if (camera.height) camera.height = Number((camera.height * factor).toPrecision(6));
  else camera.eye = add(camera.target, away, factor);
});

const pointers = new Map();
picture.onpointerdown = (event) => { picture.setPointerCapture(event.pointerId); pointers.set(event.pointerId, event); };
picture.onpointerup = picture.onpointercancel = (event) => pointers.delete(event.pointerId);
picture.oncontextmenu = (event) => event.preventDefault();
picture.onpointermove = (event) => {
  const before = pointers.get(event.pointerId);
  if (!before) return;
  const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY], tall = picture.clientHeight;
  pointers.set(event.pointerId, event);
  if (pointers.size === 2) {
    const [other] = [...pointers.values()].filter((each) => each.pointerId !== event.pointerId);
    const apart = (each) => Math.hypot(each.clientX - other.clientX, each.clientY - other.clientY);
    zoom(apart(before) / Math.max(apart(event), 1));
    pan(dx / 2 / tall, -dy / 2 / tall);
  } else if (event.buttons & 2 || event.buttons & 4 || event.shiftKey) pan(dx / tall, -dy / tall);
  else orbit(dx * TURN, dy * TURN);
};
picture.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY / 1000)); }, { passive: false });
picture.onkeydown = (event) => {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
  if (step) event.shiftKey ? pan(-step[0] / 20, -step[1] / 20) : orbit(KEY_TURN * step[0], KEY_TURN * step[1]);
  else if (event.key === "+" || event.key === "=") zoom(1 / KEY_ZOOM);
  else if (event.key === "-") zoom(KEY_ZOOM);
  else return;
  event.preventDefault();
};

// The axes of the camera's image, and half its width and height at distance 1. For a parallel camera, the distance does
// not matter.
function lens() {
  const { eye, target, height } = look.state.camera ?? controls.camera;
  const away = unit(add(eye, target, -1)), right = unit(cross(unit(controls.up), away));
  const half = height ? height / 2 : Math.tan((value("scene.camera.fov_y") ?? 40) * Math.PI / 360);
  return { eye, target, isParallel: Boolean(height), away, right, up: cross(away, right), tall: half,
    wide: half * controls.resolution[1] / controls.resolution[0] };
}

// Moves the camera without turning it, until the box of all meshes fills the picture.
function frameAll() {
  const { low, high } = controls.box, middle = low.map((x, i) => (x + high[i]) / 2);
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((n) => low.map((x, i) => (n >> i & 1 ? high[i] : x) - middle[i]));
  const { away, right, up, tall, wide } = lens();
  move((camera) => {
    const most = (of) => Math.max(...corners.map(of));
    const distance = most((c) => dot(c, away) + Math.max(Math.abs(dot(c, right)) / wide, Math.abs(dot(c, up)) / tall));
    if (camera.height) camera.height *= most((c) => Math.max(Math.abs(dot(c, right)) / wide, Math.abs(dot(c, up)) / tall));
    camera.target = middle;
    camera.eye = add(middle, away, camera.height ? Math.hypot(...add(camera.eye, camera.target, -1)) : distance);
    // The configuration's far plane may be too near.
    const far = rows.get("scene.camera.far"), needed = distance + controls.size / 2;
    if (far && needed > value("scene.camera.far")) look.state.numbers["scene.camera.far"] = Math.min(needed, far.slider.high);
  });
  refresh();
}

// --- The light in the picture: the position of a lamp, or a sun's direction shown near the first mesh ---

let held = null; // during a drag: the last event, and the offset from the handle's centre

// The light's position, and the numbers that move it.
function lampAt() {
  const name = controls?.lights[look.light] ?? "", [azimuth, elevation] = sunKeys();
  const place = [0, 1, 2].map((i) => `${name}.position.${i}`);
  if (place.every((key) => rows.has(key))) return { keys: place, at: place.map(value) };
  if (azimuth === undefined) return null;
  const a = value(azimuth) * Math.PI / 180, e = value(elevation) * Math.PI / 180;
  const direction = [Math.sin(a) * Math.cos(e), Math.sin(e), Math.cos(a) * Math.cos(e)], [wide, tall] = shownHalf(), by = lens();
  const handle = (far) => ({ keys: [azimuth, elevation], at: add(controls.middle, direction, far), far, direction });
  if (held?.far) return handle(held.far);
  const handles = SUN_AT.map((radii) => handle(controls.radius * radii));
  const isShown = ({ at }) => { const p = projected(at, by, tall); return p && Math.abs(p[0]) < wide - 15 && Math.abs(p[1]) < tall - 15; };
  return handles.find(isShown) ?? handles[0];
}

// A point of the world in pixels of the page, from the picture's centre; null behind the camera.
function projected(point, { eye, isParallel, away, right, up, tall }, half) {
  const from = add(point, eye, -1), depth = isParallel ? 1 : -dot(from, away);
  return depth > 0 ? [dot(from, right), -dot(from, up)].map((x) => x / depth / tall * half) : null;
}

// Half the size of the shown picture, in pixels of the page.
function shownHalf() {
  const scale = Math.min(picture.clientWidth / picture.width, picture.clientHeight / picture.height);
  return [picture.width * scale / 2, picture.height * scale / 2];
}

function placeLamp() {
  const lamp = images && lampAt(), [wide, tall] = shownHalf();
  const at = lamp && projected(lamp.at, lens(), tall);
  $("lamp").hidden = !at || look.view === "shadow map" || look.view === "light's view";
  if ($("lamp").hidden) return;
  const [x, y] = [Math.min(Math.max(at[0], 15 - wide), wide - 15), Math.min(Math.max(at[1], 15 - tall), tall - 15)];
  $("lamp").classList.toggle("outside", x !== at[0] || y !== at[1]);
  $("lamp").style.left = `${picture.offsetLeft + picture.clientWidth / 2 + x}px`;
  $("lamp").style.top = `${picture.offsetTop + picture.clientHeight / 2 + y}px`;
}

// Moves the light by an offset in pixels of the page. A lamp with a position keeps its depth; other lights turn.
function moveLamp(dx, dy) {
  const lamp = lampAt(), by = lens(), [, tall] = shownHalf(), { eye, away, right, up, isParallel } = by;
  const depth = isParallel ? 1 : -dot(add(lamp.at, eye, -1), away), scale = depth * by.tall / tall;
  const to = add(add(lamp.at, right, dx * scale), up, -dy * scale), found = {};
  if (lamp.keys.length === 3) lamp.keys.forEach((key, i) => { found[key] = to[i]; });
  else {
    // The line of sight meets the sphere around the mesh. Of the two points, take the one on the light's side.
    const sight = isParallel ? away.map((x) => -x) : unit(add(to, eye, -1)), from = isParallel ? add(to, away, lamp.far) : eye;
    const start = add(from, controls.middle, -1), b = dot(start, sight), root = b * b - dot(start, start) + lamp.far ** 2;
    const meets = root < 0 ? [add(start, sight, -b)] : [-1, 1].map((sign) => add(start, sight, -b + sign * Math.sqrt(root)));
    const [x, y, z] = meets.map(unit).sort((p, q) => dot(q, lamp.direction) - dot(p, lamp.direction))[0];
    found[lamp.keys[0]] = Math.atan2(x, z) * 180 / Math.PI;
    found[lamp.keys[1]] = Math.max(Math.asin(y) * 180 / Math.PI, 1);
  }
  for (const key in found) {
    const { low, high } = rows.get(key).slider;
    found[key] = Number(Math.min(Math.max(found[key], low), high).toPrecision(6));
  }
  change(({ numbers }) => Object.assign(numbers, found));
  refresh();
}

$("lamp").onpointerdown = (event) => { $("lamp").setPointerCapture(event.pointerId); held = { event, far: lampAt().far }; };
$("lamp").onpointerup = $("lamp").onpointercancel = () => { held = null; };
$("lamp").onpointermove = (event) => {
  if (!held) return;
  const [dx, dy] = [event.clientX - held.event.clientX, event.clientY - held.event.clientY];
  held.event = event;
  moveLamp(dx, dy);
};
$("lamp").onkeydown = (event) => {
  const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
  if (!step) return;
  moveLamp(...step.map((x) => 8 * x));
  event.preventDefault();
};
addEventListener("resize", placeLamp);

// --- The sun: its azimuth and elevation, seen from above ---

function sunKeys() {
  const name = controls?.lights[look.light] ?? "";
  const keys = [`${name}.azimuth`, `${name}.elevation`];
  return keys.every((key) => rows.has(key)) ? keys : [`${name}.orbit.azimuth`, `${name}.orbit.elevation`].filter((key) => rows.has(key));
}

$("sky").onpointerdown = (event) => { $("sky").setPointerCapture(event.pointerId); aim(event); };
$("sky").onpointermove = (event) => { if (event.buttons & 1) aim(event); };

function aim(event) {
  const box = $("sky").getBoundingClientRect(), half = box.width / 2.6;
  const [x, y] = [(event.clientX - box.left) / half - 1.3, (event.clientY - box.top) / half - 1.3];
  const [azimuth, elevation] = sunKeys();
  const found = { [azimuth]: Math.atan2(x, y) * 180 / Math.PI, [elevation]: Math.max(90 - 90 * Math.hypot(x, y), 1) };
  for (const key in found) found[key] = Math.round(found[key] * 10) / 10;
  change(({ numbers }) => Object.assign(numbers, found));
  refresh();
}

// --- Fits ---

let curve = [], shownFit = 0, ownFit = null, fittedOf = "", isFitting = false;

// The settings that a fit's values are valid for.
const structure = () => JSON.stringify([look.state.scene, look.state.structure]);

// The sliders follow a fit that this page started, until it shows another filter, technique or scene.
function followFit(news) {
  if (news.number === ownFit && news.values && fittedOf === structure()) take(news.values);
  showFit(news);
}

function showFit(news) {
  if (!("number" in news)) return;
  if (news.number !== shownFit || news.steps) {
    shownFit = news.number;
    curve = [...news.steps ?? []];
  }
  if (news.step) curve.push(news.step);
  isFitting = news.running && news.number === ownFit;
  if (!isFitting) {
    clearTimeout(pause);
    pause = setTimeout(() => settle(), PAUSE);
  }
  $("take").hidden = !news.done || (news.number === ownFit && fittedOf === structure());
  if (news.done) $("take").onclick = () => take(news.values);
  $("fit").disabled = news.running;
  $("stop").disabled = !news.running;
  if (news.error) say("error", news.error);
  const last = curve.at(-1);
  say("fit-note", news.error ? "failed" : news.note ?? (last ? `step ${curve.length}, RMSE ${last.error.toFixed(4)}` : ""));
  drawCurve();
}

function take(values) {
  change(({ numbers }) => { for (const key in values) if (rows.has(key)) numbers[key] = values[key]; });
  refresh();
}

function drawCurve() {
  const canvas = $("curve"), on = canvas.getContext("2d"), { width, height } = canvas;
  canvas.hidden = curve.length < 2;
  if (canvas.hidden) return;
  const errors = curve.map((step) => Math.log10(Math.max(step.error, 1e-6)));
  const [low, high] = [Math.min(...errors), Math.max(...errors)], style = getComputedStyle(document.body);
  const at = (i) => [8 + (width - 16) * i / (curve.length - 1), 22 + (height - 30) * (high - errors[i]) / Math.max(high - low, 1e-6)];
  on.clearRect(0, 0, width, height);
  on.strokeStyle = getComputedStyle($("undo")).color;
  on.fillStyle = style.color;
  on.lineWidth = 2;
  on.font = "20px system-ui";
  on.fillText(`RMSE ${(10 ** errors[0]).toPrecision(3)} → ${(10 ** errors.at(-1)).toPrecision(3)}, soft compare`, 8, 18);
  on.beginPath();
  // The soft compare has a different width in each phase, so errors of different phases do not compare.
  curve.forEach((step, i) => (i && step.phase === curve[i - 1].phase ? on.lineTo(...at(i)) : on.moveTo(...at(i))));
  on.stroke();
}

// --- Buttons ---

function saved({ yaml, name, command }) {
  if (saved.wants === "command") return copy(command, "Copied the command");
  const link = element("a", "", { href: URL.createObjectURL(new Blob([yaml], { type: "text/yaml" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  say("note", `saved ${name}`);
}

function savePicture(data) {
  const link = element("a", "", { href: `data:image/png;base64,${data}`, download: `${controls.name}-view.png` });
  link.click();
  say("note", `saved ${link.download}`);
}

async function copy(text, told) {
  document.body.dataset.copied = text; // for tests, and pages without a clipboard
  try { await navigator.clipboard.writeText(text); say("note", told); } catch { say("note", text); }
}

$("fit").onclick = () => { say("error", ""); send({ fit: look.state }); };
$("stop").onclick = () => send({ stop: true });
$("save").onclick = () => { saved.wants = "file"; send({ save: look.state }); };
$("command").onclick = () => { saved.wants = "command"; send({ save: look.state }); };
$("code").onclick = () => send({ code: look });
$("share").onclick = () => { settle(true); copy(location.href, "Copied the link"); };
$("undo").onclick = undo;
$("redo").onclick = redo;
$("frame").onclick = frameAll;
$("png").onclick = () => send({ picture: look });
$("search").oninput = find;
$("reset").onclick = () => { change((state) => Object.assign(state, blank(), { scene: state.scene })); settle(); refresh(); };
$("view").onchange = () => { look.view = $("view").value; change(() => {}); };
$("light").onchange = () => { look.light = $("light").selectedIndex; change(() => {}); };
$("scene").onchange = () => change((state) => Object.assign(state, blank(), { scene: $("scene").selectedIndex ? $("scene").value : null }));
$("split").onchange = () => {
  const chosen = $("split").value;
  look.split = chosen === NOTHING ? false : chosen === OWN || chosen.replace(/ defaults$/, "");
  change(() => {});
};
$("divider").oninput = paint;
addEventListener("keydown", (event) => {
  // Text fields have their own undo.
  if (["number", "search"].includes(event.target.type)) return;
  const key = event.key.toLowerCase();
  if (event.ctrlKey || event.metaKey) {
    const act = key === "y" || (key === "z" && event.shiftKey) ? redo : key === "z" ? undo : null;
    if (!act) return;
    event.preventDefault();
    act();
  } else if (key === "f" && event.target.tagName !== "SELECT" && controls) frameAll();
});
addEventListener("hashchange", () => { if (location.hash.length > 1 && decodeURIComponent(location.hash.slice(1)) !== settled) adopt(decodeURIComponent(location.hash.slice(1))); });

if (location.hash.length > 1) {
  try { look = { ...look, ...JSON.parse(decodeURIComponent(location.hash.slice(1))) }; settled = JSON.stringify(look); }
  catch { say("error", "the address of this page holds no settings; expected what Copy link gives"); }
}
connect();
