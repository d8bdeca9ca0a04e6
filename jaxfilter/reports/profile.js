// The profile: points of a band around the line, and the ground below it.

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
