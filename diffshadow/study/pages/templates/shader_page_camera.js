// The camera of the page, which the reader moves.

// Matrices are lists of 16 numbers in column-major order.
const times = (a, b) => a.map((_, i) => [0, 1, 2, 3].reduce((sum, k) => sum + a[(i % 4) + 4 * k] * b[4 * (i >> 2) + k], 0));
const moved = (x, y, z) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
const turned = (angle, i, j) => {
  const made = moved(0, 0, 0), [c, s] = [Math.cos(angle), Math.sin(angle)];
  [made[5 * i], made[5 * j], made[4 * i + j], made[4 * j + i]] = [c, c, s, -s];
  return made;
};

const orbit = { yaw: 0, pitch: 0, zoom: 1 };

// The configuration's camera after orbiting and zooming. Before any movement, it equals the configuration's camera to
// the bit.
function cameraNow() {
  const { yaw, pitch, zoom } = orbit, [x, y, z] = camera.target;
  let { world_to_eye, eye_to_clip } = camera;
  if (yaw || pitch || zoom !== 1) {
    const at = times(world_to_eye, moved(x, y, z)).slice(12, 15);
    const about = [moved(at[0], at[1], camera.perspective ? at[2] * zoom : at[2]), turned(pitch, 1, 2), moved(...at.map((c) => -c))];
    world_to_eye = [...about, world_to_eye, moved(x, y, z), turned(yaw, 2, 0), moved(-x, -y, -z)].reduce(times);
    eye_to_clip = [...eye_to_clip];
    if (!camera.perspective) [0, 5].forEach((i) => { eye_to_clip[i] /= zoom; });
    // The depth range of the picture moves with the camera.
    const distance = -at[2] * (camera.perspective ? zoom : 1), far = distance + camera.reach;
    const near = camera.perspective ? Math.min(1, zoom) * camera.near : distance - camera.reach;
    [eye_to_clip[10], eye_to_clip[14]] = camera.perspective
      ? [-(far + near) / (far - near), -2 * far * near / (far - near)] : [-2 / (far - near), -(far + near) / (far - near)];
  }
  const back = [2, 6, 10].map((i) => world_to_eye[i]);
  const eye = [0, 1, 2].map((k) => -[0, 1, 2].reduce((sum, i) => sum + world_to_eye[4 * k + i] * world_to_eye[12 + i], 0));
  return { world_to_eye, eye_to_clip, eye: camera.perspective ? [...eye, 1] : [...back, 0] };
}

// A drag turns the camera; a wheel or two fingers zoom. Keys do both. While the camera moves, a slow machine draws
// fewer pixels.
function control(draw) {
  const touching = new Map(), initial = { ...orbit };
  let waits = false, slow = false, rest = 0;
  const show = (moving) => {
    clearTimeout(rest);
    if (moving && slow) rest = setTimeout(() => show(false), 250);
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => {
      waits = false;
      const began = performance.now(), scale = moving && slow ? 0.5 : 1;
      draw(scale);
      if (scale < 1) return;
      slow = performance.now() - began > 60;
      document.body.dataset.fullPicture ??= Math.round(performance.now());
    });
  };
  const turn = (yaw, pitch, zoom = 1) => {
    orbit.yaw += yaw;
    orbit.pitch = Math.min(Math.max(orbit.pitch + pitch, -camera.elevation - 0.1), 1.55 - camera.elevation);
    orbit.zoom = Math.min(Math.max(orbit.zoom * zoom, 0.1), 8);
    show(true);
  };
  const spread = ([a, b]) => Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
  const on = (target, names, act, options) => names.split(" ").forEach((name) => target?.addEventListener(name, act, options));
  on(canvas, "pointerdown", (event) => { touching.set(event.pointerId, event); canvas.setPointerCapture(event.pointerId); });
  on(canvas, "pointerup pointercancel", (event) => touching.delete(event.pointerId));
  on(canvas, "pointermove", (event) => {
    const last = touching.get(event.pointerId);
    if (!last) return;
    const before = touching.size === 2 && spread([...touching.values()]);
    touching.set(event.pointerId, event);
    if (before) turn(0, 0, before / Math.max(spread([...touching.values()]), 1));
    else turn((event.clientX - last.clientX) * 0.008, (event.clientY - last.clientY) * 0.008);
  });
  on(canvas, "wheel", (event) => { event.preventDefault(); turn(0, 0, Math.exp(event.deltaY * 0.001)); }, { passive: false });
  const keys = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1], "+": [0, 0, 0.9], "-": [0, 0, 1.1] };
  on(canvas, "keydown", (event) => { if (keys[event.key]) { event.preventDefault(); turn(...keys[event.key]); } });
  on(document.getElementById("reset"), "click", () => { Object.assign(orbit, initial); show(false); });
  on(cut, "input", () => show(true));
  on(view, "change", () => show(false));
  show(false);
}
