// The map: relief, layers, points and marks; how a pointer and keys move it.

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

/** Where on a canvas each point's dot begins, as an index of its pixels; -1 outside. Kept until the view changes. */
function pixelsOfPoints(w, h, ratio, dot) {
  const {view, sample: {x, y, low, step}} = state, key = [w, h, dot, view.x, view.y, view.scale].join();
  if (state.places && state.places.key === key) return state.places.at;
  const n = x.length, at = state.places ? state.places.at : new Int32Array(n), scale = view.scale * ratio, back = dot >> 1;
  const ax = w / 2 + (low[0] - view.x) * scale - back, bx = step[0] * scale;
  const ay = h / 2 - (low[1] - view.y) * scale - back, by = -step[1] * scale;
  for (let i = 0; i < n; i++) {
    const px = Math.floor(ax + bx * x[i]), py = Math.floor(ay + by * y[i]);
    at[i] = px < 0 || py < 0 || px + dot > w || py + dot > h ? -1 : py * w + px;
  }
  state.places = {key, at};
  return at;
}

function drawPoints() {
  const canvas = el("over"), ctx = fit(canvas), w = canvas.width, h = canvas.height, which = state.kinds;
  if (!which || !w || !h) { ctx.clearRect(0, 0, w, h); return; }
  const ratio = w / canvas.clientWidth, labels = state.points === "labels", n = which.length;
  const spacing = Math.sqrt(facts.grid.nx * facts.grid.ny / n) * facts.grid.cell * state.view.scale * ratio;
  const dot = Math.max(labels ? 1 : 2, Math.min(6, Math.round(spacing * (labels ? .8 : .5)))), places = pixelsOfPoints(w, h, ratio, dot);
  const image = ctx.createImageData(w, h), out = new Uint32Array(image.data.buffer), colours = new Uint32Array(256);
  COLOURS.forEach((c, i) => { colours[i] = 0xff000000 | parseInt(c.slice(5, 7), 16) << 16 | parseInt(c.slice(3, 5), 16) << 8 | parseInt(c.slice(1, 3), 16); });
  for (let i = 0; i < n; i++) {
    const colour = colours[which[i]];
    if (!colour || places[i] < 0) continue;
    for (let r = 0, at = places[i]; r < dot; r++, at += w) for (let c = 0; c < dot; c++) out[at + c] = colour;
  }
  ctx.putImageData(image, 0, 0);
  canvas.style.opacity = !labels ? .9 : state.layer === "shade" ? .65 : .45;
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
