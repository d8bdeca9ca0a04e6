// The page: maps, slider, profile and tables. Names of data.js are in scope.

const el = id => document.getElementById(id);
const facts = JSON.parse(el("facts").textContent);
const number = (value, digits = 0) => value === null || value === undefined ? "undefined"
  : value.toLocaleString("en", {minimumFractionDigits: digits, maximumFractionDigits: digits});
const state = {
  step: facts.step, layer: "shade", points: "labels", line: [], drawing: false, ready: false,
  view: null, cursor: null, rasters: {}, sample: null, kinds: null, picture: null, band: null,
};

function cell(tag, text, right) {
  const out = document.createElement(tag);
  out.textContent = text;
  if (right) out.className = "n";
  return out;
}

function table(target, heading, rows) {
  const out = document.createElement("table"), head = document.createElement("thead"), body = document.createElement("tbody");
  const top = document.createElement("tr");
  heading.forEach((text, i) => { const th = cell("th", text, i > 0); th.scope = "col"; top.append(th); });
  head.append(top);
  for (const row of rows) {
    const line = document.createElement("tr"), first = cell("th", row[0]);
    first.scope = "row";
    line.append(first, ...row.slice(1).map(text => cell("td", text, true)));
    body.append(line);
  }
  out.append(head, body);
  el(target).replaceChildren(out);
}

// ---- figures that follow the slider --------------------------------------------------------------------------------

const SCORES = {type1: "Type I error", type2: "Type II error", total: "Total error", kappa: "Kappa"};

function showFigures() {
  const k = state.step, ground = facts.ground[k], cards = [
    ["ground", number(ground), "ground points"],
    ["share", facts.points ? number(100 * ground / facts.points, 1) + " %" : "–", "of " + number(facts.points) + " points"],
  ];
  if (k !== facts.step) cards.push(["change", (ground > facts.ground[facts.step] ? "+" : "") + number(ground - facts.ground[facts.step]), "against the run"]);
  if (facts.scores) for (const [key, name] of Object.entries(SCORES)) {
    const value = facts.scores[key][k];
    cards.push([key, value === null ? "–" : number(value, 2) + " %", name]);
  }
  el("cards").replaceChildren(...cards.map(([id, value, text]) => {
    const card = document.createElement("div"), b = document.createElement("b"), span = document.createElement("span");
    b.id = "card-" + id; b.textContent = value; span.textContent = text;
    card.append(b, span);
    return card;
  }));
  if (facts.confusion) {
    const [[a, b], [c, d]] = facts.confusion[k];
    table("scores", ["points", "labelled ground", "labelled object"], [
      ["reference ground", number(a), number(b)], ["reference object", number(c), number(d)]]);
  }
  const rows = facts.classes.filter(row => row[2][k] > 0).map(([old, next, counts]) =>
    [String(old), old === next ? "kept" : String(next), number(counts[k])]);
  table("classes", ["class before", "class after", "points"], rows);
}

function showSlider() {
  const {values, threshold} = facts, k = state.step;
  if (!threshold) return;
  const unit = threshold.unit ? " " + threshold.unit : "";
  el("slider").value = k;
  el("slider").setAttribute("aria-valuetext", values[k] + unit);
  el("slider-value").textContent = values[k] + unit;
  const canvas = el("histogram"), ctx = fit(canvas), w = canvas.clientWidth, h = canvas.clientHeight;
  const parts = facts.ground.map((v, i) => i ? Math.abs(v - facts.ground[i - 1]) : 0), top = Math.max(1, ...parts);
  ctx.clearRect(0, 0, w, h);
  parts.forEach((v, i) => {
    ctx.fillStyle = i <= k ? "#8c5a2b" : "#b9c6c0";
    const width = w / parts.length;
    ctx.fillRect(i * width + .5, h - 2 - (h - 6) * Math.sqrt(v / top), Math.max(1, width - 1), (h - 6) * Math.sqrt(v / top) + 2);
  });
}

function setStep(k) {
  state.step = Math.max(0, Math.min(facts.values.length - 1, Number(k)));
  showSlider();
  showFigures();
  relabel();
}

function relabel() {
  if (!state.sample) return;
  state.kinds = state.points === "none" ? null : kinds(state.sample, state.points, state.step, facts.step, facts.nested);
  drawPoints();
  drawProfile();
}

// ---- the map -------------------------------------------------------------------------------------------------------

/** Sizes a canvas to its place on the screen; its context, in CSS pixels. */
function fit(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  return ctx;
}

const size = () => [el("map").clientWidth, el("map").clientHeight];
const toScreen = ([x, y]) => [size()[0] / 2 + (x - state.view.x) * state.view.scale, size()[1] / 2 - (y - state.view.y) * state.view.scale];
const toMap = ([px, py]) => [state.view.x + (px - size()[0] / 2) / state.view.scale, state.view.y - (py - size()[1] / 2) / state.view.scale];

function showAll() {
  const {x0, y0, cell: side, nx, ny} = facts.grid, [w, h] = size();
  state.view = {x: x0 + nx * side / 2, y: y0 + ny * side / 2, scale: Math.min(w / (nx * side), h / (ny * side)) * .98 || 1};
  drawMap();
}

function zoom(factor, at = [size()[0] / 2, size()[1] / 2]) {
  const before = toMap(at), least = .2 * Math.min(size()[0], size()[1]) / (facts.grid.cell * Math.max(facts.grid.nx, facts.grid.ny));
  state.view.scale = Math.max(least, Math.min(400, state.view.scale * factor));
  const after = toMap(at);
  state.view.x += before[0] - after[0];
  state.view.y += before[1] - after[1];
  drawMap();
}

function scaleOf(layer) {
  if (layer === "doubt") return [0, 100];
  const values = state.rasters[layer];
  return layer === "height" ? [0, Math.max(50, percentile(values, .99, 65535))]
    : [percentile(values, .005, 65535), percentile(values, .995, 65535)];
}

function paintLayer() {
  const {nx, ny} = facts.grid, layer = state.layer, scale = layer === "shade" || layer === "errors" ? [0, 1] : scaleOf(layer);
  state.picture = state.picture || document.createElement("canvas");
  state.picture.width = nx; state.picture.height = ny;
  state.picture.getContext("2d").putImageData(new ImageData(pixels(layer, state.rasters, scale), nx, ny), 0, 0);
  state.scale = scale;
  showLegend();
}

let asked = false;
function drawMap() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => { asked = false; drawBase(); drawPoints(); drawMarks(); });
}

function drawBase() {
  const ctx = fit(el("base")), {x0, y0, cell: side, nx, ny} = facts.grid, [px, py] = toScreen([x0, y0 + ny * side]);
  ctx.clearRect(0, 0, ...size());
  ctx.imageSmoothingEnabled = state.view.scale * side < 8;
  ctx.drawImage(state.picture, px, py, nx * side * state.view.scale, ny * side * state.view.scale);
}

function drawPoints() {
  const canvas = el("over"), ctx = fit(canvas), w = canvas.width, h = canvas.height, points = state.sample;
  if (!state.kinds || !w || !h) { ctx.clearRect(0, 0, w, h); return; }
  const ratio = w / canvas.clientWidth, scale = state.view.scale * ratio, image = ctx.createImageData(w, h);
  const out = new Uint32Array(image.data.buffer);
  const colours = COLOURS.map(c => 0xff000000 | parseInt(c.slice(5, 7), 16) << 16 | parseInt(c.slice(3, 5), 16) << 8 | parseInt(c.slice(1, 3), 16));
  const {x, y, low, step} = points, which = state.kinds, n = x.length;
  const ax = w / 2 + (low[0] - state.view.x) * scale, bx = step[0] * scale, ay = h / 2 - (low[1] - state.view.y) * scale, by = -step[1] * scale;
  const spacing = Math.sqrt(facts.grid.nx * facts.grid.ny / n) * facts.grid.cell * scale;
  const dot = Math.max(state.points === "labels" ? 1 : 2, Math.min(6, Math.round(spacing * (state.points === "labels" ? .8 : .5)))), back = dot >> 1;
  for (let i = 0; i < n; i++) {
    if (which[i] === 255) continue;
    const px = (ax + bx * x[i] | 0) - back, py = (ay + by * y[i] | 0) - back;
    if (px < 0 || py < 0 || px + dot > w || py + dot > h) continue;
    const colour = colours[which[i]];
    for (let r = 0, at = py * w + px; r < dot; r++, at += w) for (let c = 0; c < dot; c++) out[at + c] = colour;
  }
  ctx.putImageData(image, 0, 0);
  canvas.style.opacity = state.points === "labels" && state.layer !== "shade" ? .45 : .8;
}

function drawMarks() {
  const ctx = fit(el("marks")), [w, h] = size();
  ctx.clearRect(0, 0, w, h);
  const target = w / 5 / state.view.scale, power = 10 ** Math.floor(Math.log10(target));
  const length = [5, 2, 1].map(f => f * power).find(v => v <= target), wide = length * state.view.scale;
  ctx.font = "12px system-ui, sans-serif";
  ctx.fillStyle = "rgba(255,255,255,.85)"; ctx.fillRect(w - wide - 24, h - 34, wide + 16, 26);
  ctx.fillStyle = "#1d2528"; ctx.fillRect(w - wide - 16, h - 14, wide, 3);
  ctx.textAlign = "center"; ctx.fillText(number(length, length < 1 ? 1 : 0) + " m", w - wide / 2 - 16, h - 19);
  const line = state.line.map(toScreen);
  for (const [style, width] of [["#fff", 5], ["#c2185b", 2.5]]) {
    ctx.strokeStyle = style; ctx.lineWidth = width; ctx.beginPath();
    if (line.length === 2) { ctx.moveTo(...line[0]); ctx.lineTo(...line[1]); ctx.stroke(); }
    for (const [px, py] of line) { ctx.beginPath(); ctx.arc(px, py, 5, 0, 7); ctx.stroke(); }
  }
  line.forEach(([px, py], i) => { ctx.fillStyle = "#c2185b"; ctx.font = "bold 14px system-ui, sans-serif"; ctx.fillText("AB"[i], px + 14, py - 8); });
  if (state.cursor && document.activeElement === el("map")) {
    const [px, py] = toScreen(state.cursor);
    ctx.strokeStyle = "#c2185b"; ctx.lineWidth = 1.5; ctx.beginPath();
    ctx.moveTo(px - 12, py); ctx.lineTo(px + 12, py); ctx.moveTo(px, py - 12); ctx.lineTo(px, py + 12); ctx.stroke();
  }
}

function toFile([x, y]) {
  const {origin, units} = facts.frame;
  return [origin[0] + x / units[0], origin[1] + y / units[0]];
}

const zFile = z => facts.frame.origin[2] + z / facts.frame.units[1];

function showReadout(at) {
  const [x, y] = toFile(at), i = cellAt(facts.grid, ...at), parts = [`x ${number(x, 2)}  y ${number(y, 2)}`], {rasters} = state;
  if (i >= 0) {
    if (rasters.elevation[i] !== 65535) parts.push("ground " + number(zFile(facts.elevation.low + rasters.elevation[i] * facts.elevation.step), 2));
    if (rasters.height[i] !== 65535) parts.push("highest point " + number(rasters.height[i] / 100, 2) + " m above");
    if (rasters.doubt && rasters.doubt[i] !== 255) parts.push("doubt " + rasters.doubt[i] + " %");
  }
  el("readout").textContent = parts.join("   ·   ");
}

function showLegend() {
  const items = [], add = (colour, text) => {
    const li = document.createElement("li"), i = document.createElement("i");
    i.style.background = colour;
    if (colour.startsWith("linear")) i.className = "ramp";
    li.append(i, text);
    items.push(li);
  };
  const ramp = name => `linear-gradient(90deg,${RAMPS[name].map(c => `rgb(${c})`).join(",")})`, [low, high] = state.scale || [0, 1];
  if (state.layer === "height") add(ramp("height"), `highest point above the ground, 0 to ${number(high / 100, 1)} m`);
  if (state.layer === "doubt") add(ramp("doubt"), "doubt, 0 to 100 %");
  if (state.layer === "elevation") {
    const z = v => number(zFile(facts.elevation.low + v * facts.elevation.step), 1);
    add(ramp("elevation"), `elevation of the ground, ${z(low)} to ${z(high)}`);
  }
  if (state.layer === "errors") { add(KINDS.lost[2], "cell with ground lost"); add(KINDS.accepted[2], "with an object accepted"); add("#cc79a7", "with both"); }
  const of = {labels: ["ground", "object", "aside"], errors: ["lost", "accepted"], changes: ["gained", "dropped"]}[state.points] || [];
  of.forEach(key => add(KINDS[key][2], KINDS[key][1]));
  if (of.length && state.sample && facts.sample.number < facts.sample.of)
    items.push(Object.assign(document.createElement("li"), {textContent: `${number(facts.sample.number)} of ${number(facts.sample.of)} points are drawn`}));
  el("legend").replaceChildren(...items);
}

// ---- the profile ---------------------------------------------------------------------------------------------------

function setLine(line) {
  state.line = line;
  if (line.length === 2) state.drawing = false;
  el("draw").setAttribute("aria-pressed", state.drawing);
  el("profile-section").hidden = line.length < 2;
  findBand();
  drawMarks();
  drawProfile();
}

function findBand() {
  const width = Math.max(.1, Number(el("width").value) || 2);
  state.band = state.line.length === 2 && state.sample ? band(state.sample, ...state.line, width) : null;
}

function drawProfile() {
  if (!state.band || !state.band.length) return;
  const canvas = el("profile"), ctx = fit(canvas), w = canvas.clientWidth, h = canvas.clientHeight;
  const {index, distance, length} = state.band, {z, low, step} = state.sample, {grid, elevation} = facts, [a, b] = state.line;
  const left = 58, bottom = 30, right = 12, top = 10, ground = [];
  for (let i = 0; i <= 400; i++) {
    const s = i / 400, v = elevationAt(grid, state.rasters.elevation, a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]));
    ground.push([s * length, v === null ? null : elevation.low + v * elevation.step]);
  }
  const heights = index.map(i => low[2] + z[i] * step[2]), known = [...heights, ...ground.map(g => g[1]).filter(v => v !== null)].sort((p, q) => p - q);
  ctx.clearRect(0, 0, w, h);
  const pick = share => known[Math.min(known.length - 1, Math.floor(share * known.length))] ?? 0, cut = known.length > 400 ? .002 : 0;
  const pad = Math.max(.5, .06 * (pick(1 - cut) - pick(cut))), zLow = pick(cut) - pad, zHigh = pick(1 - cut) + pad;
  const px = s => left + s / length * (w - left - right), py = v => h - bottom - (v - zLow) / (zHigh - zLow) * (h - bottom - top);
  state.axes = {left, right, w, length};
  ctx.font = "12px system-ui, sans-serif"; ctx.lineWidth = 1; ctx.strokeStyle = "#e3e8e9"; ctx.fillStyle = "#5c686d";
  const offset = zFile(0), unit = facts.frame.units[1], zs = ticks(offset + zLow / unit, offset + zHigh / unit, 5), ss = ticks(0, length, Math.max(3, w / 140));
  ctx.textAlign = "right";
  for (const v of zs.values) { const at = py((v - offset) * unit); ctx.beginPath(); ctx.moveTo(left, at); ctx.lineTo(w - right, at); ctx.stroke(); ctx.fillText(number(v, zs.digits), left - 6, at + 4); }
  ctx.textAlign = "center";
  for (const v of ss.values) { ctx.beginPath(); ctx.moveTo(px(v), top); ctx.lineTo(px(v), h - bottom); ctx.stroke(); ctx.fillText(number(v, ss.digits) + " m", Math.min(px(v), w - 24), h - 10); }
  ctx.strokeStyle = "#1d2528"; ctx.lineWidth = 1.2; ctx.beginPath();
  let pen = false;
  for (const [s, v] of ground) { if (v === null) pen = false; else { pen ? ctx.lineTo(px(s), py(v)) : ctx.moveTo(px(s), py(v)); pen = true; } }
  ctx.stroke();
  const labels = kinds({code: index.map(i => state.sample.code[i]), flags: index.map(i => state.sample.flags[i])}, "labels", state.step, facts.step, facts.nested);
  const wrong = facts.scores ? kinds({code: index.map(i => state.sample.code[i]), flags: index.map(i => state.sample.flags[i])}, "errors", state.step, facts.step, facts.nested) : null;
  let on = 0;
  index.forEach((_, i) => {
    const kind = wrong && wrong[i] !== 255 ? wrong[i] : labels[i], r = kind > 2 ? 2.6 : 1.7;
    on += labels[i] === 0;
    ctx.fillStyle = COLOURS[kind];
    ctx.fillRect(px(distance[i]) - r, Math.max(top, Math.min(h - bottom, py(heights[i]))) - r, 2 * r, 2 * r);
  });
  el("profile-count").textContent = `A to B ${number(length, 1)} m, ${number(index.length)} points of the sample, ${number(on)} ground`;
}

// ---- input ---------------------------------------------------------------------------------------------------------

function listenMap() {
  const map = el("map"), down = new Map();
  let moved = false, apart = 0;
  const at = event => { const box = map.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  map.addEventListener("pointerdown", event => {
    map.setPointerCapture(event.pointerId);
    down.set(event.pointerId, at(event));
    if (down.size === 1) moved = false;
  });
  map.addEventListener("pointermove", event => {
    const here = at(event), last = down.get(event.pointerId);
    if (!last) { state.cursor = toMap(here); showReadout(state.cursor); return; }
    if (down.size === 1) {
      if (!moved && Math.hypot(here[0] - last[0], here[1] - last[1]) < 5) return;
      moved = true;
      state.view.x -= (here[0] - last[0]) / state.view.scale;
      state.view.y += (here[1] - last[1]) / state.view.scale;
      down.set(event.pointerId, here);
      drawMap();
      return;
    }
    moved = true;
    down.set(event.pointerId, here);
    const [p, q] = [...down.values()], wide = Math.hypot(p[0] - q[0], p[1] - q[1]);
    if (apart) zoom(wide / apart, [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2]);
    apart = wide;
  });
  const up = event => {
    const was = down.delete(event.pointerId);
    apart = 0;
    if (!was || moved || event.type === "pointercancel") return;
    state.cursor = toMap(at(event));
    showReadout(state.cursor);
    mark(state.cursor);
  };
  map.addEventListener("pointerup", up);
  map.addEventListener("pointercancel", up);
  map.addEventListener("wheel", event => { event.preventDefault(); zoom(Math.exp(-event.deltaY * .0015), at(event)); }, {passive: false});
  map.addEventListener("focus", drawMarks);
  map.addEventListener("blur", drawMarks);
  map.addEventListener("keydown", event => {
    const way = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]}[event.key];
    if (way) {
      const stride = 20 / state.view.scale;
      if (event.shiftKey) { state.view.x += 4 * way[0] * stride; state.view.y += 4 * way[1] * stride; }
      else { state.cursor = state.cursor || [state.view.x, state.view.y]; state.cursor = [state.cursor[0] + way[0] * stride, state.cursor[1] + way[1] * stride]; showReadout(state.cursor); }
      drawMap();
    } else if (event.key === "+" || event.key === "=") zoom(1.4);
    else if (event.key === "-") zoom(1 / 1.4);
    else if (event.key === "Enter") mark(state.cursor || [state.view.x, state.view.y]);
    else if (event.key === "Escape") { state.drawing = false; setLine([]); }
    else return;
    event.preventDefault();
  });
}

/** An end of the profile: the first click begins a line, the second ends it, the next begins anew. */
function mark(at) {
  setLine(state.line.length === 1 ? [state.line[0], at] : [at]);
  if (state.line.length === 2) el("profile-section").scrollIntoView({block: "nearest", behavior: "smooth"});
}

function listPlaces() {
  const {places} = facts;
  if (!places.length) return;
  el("places-section").hidden = false;
  el("places-hint").textContent = places[0].what === "errors" ? "Squares with most cells in error." : "Squares with most points near to their threshold.";
  el("places").replaceChildren(...places.map((place, i) => {
    const button = document.createElement("button"), reach = .7 * place.side;
    button.type = "button";
    button.textContent = `${i + 1} · ${toFile([place.x, place.y]).map(v => number(v)).join(", ")}`;
    button.addEventListener("click", () => {
      state.view = {x: place.x, y: place.y, scale: Math.min(...size()) / (2.5 * place.side)};
      drawMap();
      setLine([[place.x - reach, place.y], [place.x + reach, place.y]]);
      el("map").scrollIntoView({block: "nearest", behavior: "smooth"});
    });
    return button;
  }));
}

function listen() {
  el("layer").addEventListener("change", event => { state.layer = event.target.value; paintLayer(); drawMap(); });
  el("points").addEventListener("change", event => { state.points = event.target.value; relabel(); showLegend(); });
  el("draw").addEventListener("click", () => { state.drawing = true; setLine([]); el("map").focus(); });
  el("zoom-in").addEventListener("click", () => zoom(1.5));
  el("zoom-out").addEventListener("click", () => zoom(1 / 1.5));
  el("zoom-all").addEventListener("click", showAll);
  el("width").addEventListener("input", () => { findBand(); drawProfile(); });
  el("profile").addEventListener("pointermove", event => {
    const axes = state.axes;
    if (!axes) return;
    const share = (event.clientX - el("profile").getBoundingClientRect().left - axes.left) / (axes.w - axes.left - axes.right), [a, b] = state.line;
    if (share < 0 || share > 1 || !b) return;
    const at = [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    el("profile-readout").textContent = `${number(share * axes.length, 1)} m from A: x ${toFile(at).map(v => number(v, 2)).join("  y ")}`;
  });
  window.addEventListener("resize", () => { showSlider(); drawMap(); drawProfile(); });
  listenMap();
}

function choose(id, options) {
  el(id).replaceChildren(...options.map(([value, text]) => Object.assign(document.createElement("option"), {value, textContent: text})));
}

async function start() {
  showFigures();
  el("classes-section").hidden = !facts.classes.length;
  el("scores-section").hidden = !facts.scores;
  if (facts.threshold) {
    const {name, doc, unit, symbol} = facts.threshold;
    el("slider-section").hidden = false;
    el("slider").max = facts.values.length - 1;
    el("slider-name").textContent = `${name}${symbol ? ` (${symbol})` : ""}: ${doc}${unit ? `, ${unit}` : ""}`;
    el("slider-hint").textContent = `Counts, classes and scores are those of all ${number(facts.points)} points at each of ${facts.values.length} values; `
      + "bars: points whose label changes from one value to the next. Maps of relief, height and doubt stay those of the run.";
    el("slider").addEventListener("input", event => setStep(event.target.value));
    el("slider-reset").addEventListener("click", () => setStep(facts.step));
    showSlider();
  }
  if (!facts.grid) return;
  const arrays = {};
  await Promise.all([...document.querySelectorAll("script[data-bytes]")].map(async node => {
    arrays[node.id.slice(5)] = await unpack(node.textContent, Number(node.dataset.bytes));
    node.textContent = "";
  }));
  const {x, y, z, flags, code, ...rasters} = arrays;
  state.sample = {x, y, z, flags, code, low: facts.sample.low, step: facts.sample.step};
  state.rasters = rasters;
  const spacing = facts.grid.cell * Math.sqrt(facts.grid.nx * facts.grid.ny / facts.sample.number);
  el("width").value = Math.max(1, Math.round(2 * spacing));
  el("map-section").hidden = false;
  choose("layer", [["shade", "relief of the ground"], ["height", "height above ground"], ["elevation", "elevation"],
    ...(rasters.doubt ? [["doubt", "doubt"]] : []), ...(rasters.errors ? [["errors", "errors of the run"]] : [])]);
  choose("points", [["labels", "labels"], ...(facts.scores ? [["errors", "errors"]] : []),
    ...(facts.threshold ? [["changes", "changes by the slider"]] : []), ["none", "none"]]);
  paintLayer();
  listen();
  listPlaces();
  showAll();
  relabel();
  state.ready = true;
}

window.report = {facts, state, setStep, setLine, toScreen};
start().catch(error => {
  el("problem").hidden = false;
  el("problem").textContent = `The maps could not be shown (${error.message}). A browser of 2023 or later is needed; the tables below are complete.`;
  state.failed = error.message;
});
