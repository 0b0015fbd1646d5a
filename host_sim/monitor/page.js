"use strict";
// Draws what the monitor's events tell; computes nothing of the robot itself. Lengths m, angles rad, times s.

const WINDOW_S = 20;
const LINEAR_SLIP = 0.1; // the traction curve is a line up to here
const find = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const known = (value) => value !== null && value !== undefined;
const figure = (value, factor = 1, digits = 3) => (known(value) ? (value * factor).toFixed(digits).replace(/^-(?=[0.]*$)/, "") : "–");
const largest = (values) => (values && values.every(known) ? Math.max(...values.map(Math.abs)) : null);

const WHEELS = [["--wheel1", []], ["--wheel2", [6, 3]], ["--wheel3", [2, 2]]];
const CURVES = [
  { name: "Tracking error", unit: "mm", of: (s) => [known(s.error) ? 1e3 * s.error : null], least: 0.05 },
  { name: "Speed", unit: "m/s", of: (s) => [s.speed], least: 0.1 },
  { name: "Slip ratio", unit: "", of: (s) => s.slip, least: 0.01, limit: () => LINEAR_SLIP, wheels: true },
  { name: "Torque", unit: "N·m", of: (s) => s.torque, least: 0.02, limit: () => state && state.torque_limit_Nm, wheels: true },
];

let robot = null, state = null, outline = [], samples = [], stale = false;

// ---- what comes

const source = new EventSource("events");
source.addEventListener("about", (event) => {
  // A stream that begins, begins with all there is.
  robot = JSON.parse(event.data);
  samples = []; outline = [];
  find("events").replaceChildren();
  find("node").textContent = `node ${robot.node}`;
  document.title = `omnibot monitor, node ${robot.node}`;
});
source.addEventListener("update", (event) => {
  const update = JSON.parse(event.data);
  state = update.state;
  stale = false;
  if (update.outline) outline = update.outline;
  for (const [number, clock, pose, reference, error, speed, torque, slip] of update.samples) {
    samples.push({ number, clock, pose, reference, error, speed, torque, slip });
  }
  const newest = samples.length ? samples[samples.length - 1].clock : 0;
  samples = samples.filter((sample) => sample.clock > newest - WINDOW_S && sample.clock <= newest);
  showWords(update);
  schedule();
});
source.onerror = () => {
  stale = true;
  find("notice").textContent = "The monitor has ended, or cannot be reached; trying again.";
  find("mode").className = "badge lost";
  find("mode").textContent = "not connected";
};

// ---- words

function element(name, text, className) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  return made;
}

function clockOf(time) {
  if (!known(time)) return "";
  if (time < 1e9) return `${time.toFixed(3)} s`;
  return new Date(1e3 * time).toLocaleTimeString([], { hour12: false });
}

function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

function showWords(update) {
  const mode = find("mode");
  setText(mode, state.mode || "unknown");
  mode.className = `badge ${state.mode || ""}`;
  setText(find("notice"), update.notice);
  const faults = state.faults.map((fault) => `${fault.name}: ${fault.text}`);
  if (find("faults").textContent !== faults.join("")) find("faults").replaceChildren(...faults.map((text) => element("li", text)));
  showTiles();
  find("rows").replaceChildren(...update.rows.map(([name, text, mood]) => {
    const row = element("tr", undefined, mood);
    const head = element("th", name);
    head.scope = "row";
    row.append(head, element("td", text));
    return row;
  }));
  for (const [time, text] of update.events) {
    const entry = element("li");
    entry.append(element("time", clockOf(time)), text);
    find("events").prepend(entry);
  }
  while (find("events").childElementCount > 200) find("events").lastChild.remove();
}

function showTiles() {
  const { tracking, slip, bus, step_time: step } = state;
  const tiles = [
    ["Tracking error", `${figure(tracking.error_m, 1e3)} mm`, tracking.unknown || `largest ${figure(tracking.max_error_m, 1e3)} mm`],
    ["Speed", `${figure(state.speed_m_per_s)} m/s`, `yaw ${figure(state.yaw_rate_rad_per_s)} rad/s`],
    ["Slip ratio, worst wheel", figure(largest(slip.ratio), 1, 4), `largest ${figure(slip.max_ratio, 1, 4)}`],
    ["Torque, worst wheel", `${figure(largest(state.torque_Nm))} N·m`, `of ${figure(state.torque_limit_Nm, 1, 2)}, largest ${figure(state.max_torque_Nm)}`],
    ["Step time", known(step?.mean_us) ? `${figure(step.mean_us, 1, 1)} µs` : "–", known(step?.max_us) ? `up to ${figure(step.max_us, 1, 1)}; ${step.overruns} overruns` : "not told"],
    ["Bus load", `${figure(bus.load_fraction, 100, 1)} %`, `${Math.round(bus.frames_per_s)} frames/s${known(state.pace) ? `, ${figure(state.pace, 1, 2)} × real time` : ""}`],
    ["Dropped by the robot", known(state.dropped_frames) ? String(state.dropped_frames) : "–", `damaged here ${bus.damaged_frames}`],
  ];
  const list = find("tiles");
  if (list.childElementCount !== tiles.length) {
    list.replaceChildren(...tiles.map(() => {
      const tile = element("div");
      tile.append(element("dt"), element("dd"), element("dd", "", "of"));
      return tile;
    }));
  }
  tiles.forEach((texts, place) => texts.forEach((text, part) => setText(list.children[place].children[part], text)));
}

// ---- drawing

let asked = false;
function schedule() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; draw(); });
}
addEventListener("resize", schedule);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", schedule);

function prepare(canvas) {
  const ratio = devicePixelRatio || 1, { width, height } = canvas.getBoundingClientRect();
  const pixels = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== pixels[0] || canvas.height !== pixels[1]) [canvas.width, canvas.height] = pixels;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  return { pen, width, height };
}

function polyline(pen, points) {
  pen.beginPath();
  let drawing = false;
  for (const [x, y] of points) {
    if (!known(x) || !known(y)) { drawing = false; continue; }
    if (drawing) pen.lineTo(x, y); else pen.moveTo(x, y);
    drawing = true;
  }
}

/** A round step that divides a range into at most so many parts. */
function stepOf(range, parts) {
  const raw = range / parts, power = 10 ** Math.floor(Math.log10(raw));
  return power * [1, 2, 5, 10].find((times) => times * power >= raw);
}

function pointOf(pose) {
  return [pose[0] - robot.tracked_point_m * Math.sin(pose[2]), pose[1] + robot.tracked_point_m * Math.cos(pose[2])];
}

/** What is to be seen of the ground: west, south, east, north. */
function closeUp(pose) {
  const reach = 1.6 * (robot.body_radius_m + robot.wheel_radius_m);
  return [pose[0] - reach, pose[1] - reach, pose[0] + reach, pose[1] + reach];
}

function wholeWay(pose, trail) {
  const points = [...outline, ...trail.filter((point) => known(point[0]))];
  if (pose) points.push([pose[0], pose[1]]);
  if (!points.length) points.push([0, 0]);
  const xs = points.map((point) => point[0]), ys = points.map((point) => point[1]);
  const margin = robot.body_radius_m + 2 * robot.wheel_radius_m;
  return [Math.min(...xs) - margin, Math.min(...ys) - margin, Math.max(...xs) + margin, Math.max(...ys) + margin];
}

/** The whole way above, the robot enlarged below. */
function drawWorld() {
  const { pen, width, height } = prepare(find("world"));
  const pose = state.pose, trail = samples.map((sample) => (known(sample.pose[0]) ? pointOf(sample.pose) : [null, null]));
  const cut = pose ? Math.round(0.62 * height) : height;
  drawScene(pen, { x: 0, y: 0, width, height: cut }, wholeWay(pose, trail), trail);
  if (!pose) return;
  polyline(pen, [[0, cut + 0.5], [width, cut + 0.5]]);
  pen.strokeStyle = colour("--rule"); pen.lineWidth = 1; pen.stroke();
  drawScene(pen, { x: 0, y: cut + 1, width, height: height - cut - 1 }, closeUp(pose), trail);
}

function drawScene(pen, box, [west, south, east, north], trail) {
  const scale = Math.min((box.width - 12) / (east - west), (box.height - 12) / (north - south));
  const middle = [box.x + box.width / 2, box.y + box.height / 2];
  const place = ([x, y]) => (known(x) ? [middle[0] + scale * (x - (west + east) / 2), middle[1] - scale * (y - (south + north) / 2)] : [null, null]);
  pen.save();
  pen.beginPath(); pen.rect(box.x + 1, box.y + 1, box.width - 2, box.height - 2); pen.clip();
  drawScale(pen, box, scale);
  pen.lineJoin = "round";
  polyline(pen, outline.map(place));
  pen.strokeStyle = colour("--reference"); pen.lineWidth = 6; pen.stroke();
  polyline(pen, trail.map(place));
  pen.strokeStyle = colour("--wheel1"); pen.lineWidth = 2; pen.stroke();
  if (state.pose) drawRobot(pen, place, scale, state.pose);
  if (state.tracking.reference) {
    const [x, y] = place(state.tracking.reference);
    pen.beginPath(); pen.arc(x, y, 6, 0, 2 * Math.PI);
    pen.strokeStyle = colour("--wheel2"); pen.lineWidth = 2; pen.stroke();
  }
  pen.restore();
}

/** A bar of a round length. */
function drawScale(pen, box, scale) {
  const step = stepOf(box.width / scale, 6), x = box.x + 8, y = box.y + box.height - 8;
  pen.fillStyle = pen.strokeStyle = colour("--muted");
  pen.lineWidth = 2;
  pen.beginPath();
  pen.moveTo(x, y); pen.lineTo(x + step * scale, y);
  pen.stroke();
  pen.fillText(step < 1 ? `${+(step * 100).toPrecision(3)} cm` : `${step} m`, x, y - 5);
}

/** Body, wheels and the arm to the tracked point, to scale. */
function drawRobot(pen, place, scale, pose) {
  const [x, y] = place(pose), radius = robot.wheel_radius_m;
  pen.save();
  pen.translate(x, y); pen.rotate(-pose[2]); pen.scale(scale, -scale);
  pen.lineWidth = 1.5 / scale;
  pen.strokeStyle = colour("--ink");
  pen.fillStyle = colour("--body");
  pen.beginPath(); pen.arc(0, 0, robot.body_radius_m, 0, 2 * Math.PI); pen.fill(); pen.stroke();
  pen.beginPath(); pen.moveTo(0, 0); pen.lineTo(0, robot.tracked_point_m); pen.stroke();
  robot.wheels.forEach((wheel, number) => {
    pen.save();
    pen.translate(wheel.x_m, wheel.y_m); pen.rotate(wheel.angle_rad);
    pen.fillStyle = colour(WHEELS[number % 3][0]);
    pen.fillRect(-radius, -0.35 * radius, 2 * radius, 0.7 * radius);
    pen.restore();
  });
  pen.fillStyle = colour("--wheel1");
  pen.beginPath(); pen.arc(0, robot.tracked_point_m, Math.max(0.012, 3 / scale), 0, 2 * Math.PI); pen.fill();
  pen.restore();
}

function makeCurves() {
  for (const curve of CURVES) {
    const box = element("figure"), caption = element("figcaption"), canvas = element("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${curve.name} over the last ${WINDOW_S} seconds`);
    caption.append(element("b", curve.name), curve.unit ? `(${curve.unit})` : "");
    if (curve.wheels) caption.append(...WHEELS.map(([name], wheel) => wheelKey(name, wheel)));
    curve.value = element("output");
    curve.canvas = canvas;
    caption.append(curve.value);
    box.append(caption, canvas);
    find("curves").append(box);
  }
}

function wheelKey(name, wheel) {
  const key = element("span"), mark = element("span", undefined, "key");
  mark.style.borderColor = `var(${name})`;
  mark.style.borderTopStyle = ["solid", "dashed", "dotted"][wheel];
  key.append(mark, ` ${wheel + 1}`);
  return key;
}

function drawCurve(curve) {
  const { pen, width, height } = prepare(curve.canvas);
  const lines = samples.map(curve.of), values = lines.flat().filter(known);
  const newest = samples.length ? samples[samples.length - 1].clock : 0;
  const signed = Boolean(curve.wheels);
  const top = 1.1 * Math.max(curve.least, ...values.map(Math.abs)), bottom = signed ? -top : 0;
  const left = 52, right = width - 6, upper = 6, lower = height - 18;
  const across = (time) => right - ((newest - time) / WINDOW_S) * (right - left);
  const up = (value) => lower - ((value - bottom) / (top - bottom)) * (lower - upper);
  drawAxes(pen, { left, right, upper, lower, top, bottom, up, across, newest });
  const limit = curve.limit && curve.limit();
  if (limit && limit <= top) for (const side of [limit, -limit]) {
    polyline(pen, [[left, up(side)], [right, up(side)]]);
    pen.strokeStyle = colour("--limit"); pen.setLineDash([3, 3]); pen.lineWidth = 1.5; pen.stroke();
  }
  const count = lines.length ? lines[0].length : 0;
  for (let number = 0; number < count; number++) {
    const [name, dash] = WHEELS[number];
    polyline(pen, lines.map((line, place) => (known(line[number]) ? [across(samples[place].clock), up(line[number])] : [null, null])));
    pen.setLineDash(dash); pen.strokeStyle = colour(name); pen.lineWidth = 1.6; pen.stroke();
  }
  pen.setLineDash([]);
  const last = lines.length ? lines[lines.length - 1] : [];
  setText(curve.value, last.some(known) ? last.map((value) => figure(value)).join("  ") : "not known");
}

function drawAxes(pen, { left, right, upper, lower, top, bottom, up, across, newest }) {
  pen.strokeStyle = colour("--grid"); pen.fillStyle = colour("--muted"); pen.lineWidth = 1;
  const step = stepOf(top - bottom, 4), digits = Math.max(0, -Math.floor(Math.log10(step)));
  pen.textAlign = "right"; pen.textBaseline = "middle";
  for (let value = Math.ceil(bottom / step) * step; value <= top; value += step) {
    polyline(pen, [[left, up(value)], [right, up(value)]]);
    pen.stroke();
    pen.fillText((Math.abs(value) < step / 2 ? 0 : value).toFixed(digits), left - 6, up(value));
  }
  pen.textAlign = "center"; pen.textBaseline = "alphabetic";
  for (let time = Math.ceil((newest - WINDOW_S) / 5) * 5; time <= newest; time += 5) {
    if (time < 0) continue;
    polyline(pen, [[across(time), upper], [across(time), lower]]);
    pen.stroke();
    if (across(time) > left + 12 && across(time) < right - 12) pen.fillText(`${time} s`, across(time), lower + 14);
  }
}

function draw() {
  if (!robot || !state) return;
  drawWorld();
  CURVES.forEach(drawCurve);
  document.documentElement.dataset.drawn = String(samples.length);
}

makeCurves();
