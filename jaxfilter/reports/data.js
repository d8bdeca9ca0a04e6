// What the page knows: arrays out of their packed form, labels, colours and profiles. No function here touches the page.

/** Undoes packing.pack: base64, deflate, byte planes, differences. */
async function unpack(text, bytes) {
  const raw = atob(text), packed = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) packed[i] = raw.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return summed(new Uint8Array(await new Response(stream).arrayBuffer()), bytes);
}

/** The running sum of differences whose bytes lie in planes, lowest first. */
function summed(planes, bytes) {
  const n = planes.length / bytes, out = bytes === 1 ? new Uint8Array(n) : new Uint16Array(n);
  let sum = 0;
  for (let i = 0; i < n; i++) {
    sum += planes[i] + (bytes === 2 ? planes[n + i] << 8 : 0);
    out[i] = sum;
  }
  return out;
}

/** Whether a point is ground at a step of the slider. */
function isGround(code, step, nested) {
  return nested ? code <= step : ((code >> step) & 1) === 1;
}

const JUDGED = 1, TRUE = 2, COUNTED = 4;
const KINDS = {
  ground: [0, "ground", "#8c5a2b"], object: [1, "non-ground", "#3f9b6b"], aside: [2, "not judged", "#8a9499"],
  lost: [3, "ground lost (Type I)", "#d55e00"], accepted: [4, "object accepted (Type II)", "#0072b2"],
  gained: [5, "ground only now", "#cc79a7"], dropped: [6, "ground only in the run", "#e6b800"],
};
const COLOURS = Object.values(KINDS).map(kind => kind[2]);

/** u8 per point: which of KINDS it is drawn as, 255 for not at all. what: "labels", "errors" or "changes". */
function kinds(points, what, step, run, nested) {
  const {code, flags} = points, n = code.length, out = new Uint8Array(n);
  for (let i = 0; i < n; i++) {
    const on = nested ? code[i] <= step : (code[i] >> step) & 1, flag = flags[i];
    if (what === "labels") out[i] = on ? 0 : flag & JUDGED ? 1 : 2;
    else if (what === "errors") {
      const truth = flag & TRUE;
      out[i] = !(flag & COUNTED) ? 255 : truth && !on ? 3 : !truth && on ? 4 : 255;
    } else {
      const before = nested ? code[i] <= run : (code[i] >> run) & 1;
      out[i] = on && !before ? 5 : before && !on ? 6 : 255;
    }
  }
  return out;
}

/** Points of a band around the line from a to b, local metres: {index, distance}, along the line. */
function band(points, a, b, width) {
  const dx = b[0] - a[0], dy = b[1] - a[1], length = Math.hypot(dx, dy), index = [], distance = [];
  if (!(length > 0)) return {index, distance, length: 0};
  const ux = dx / length, uy = dy / length, {x, y, low, step} = points, half = width / 2;
  for (let i = 0; i < x.length; i++) {
    const px = low[0] + x[i] * step[0] - a[0], py = low[1] + y[i] * step[1] - a[1];
    if (Math.abs(py * ux - px * uy) > half) continue;
    const s = px * ux + py * uy;
    if (s >= 0 && s <= length) { index.push(i); distance.push(s); }
  }
  return {index, distance, length};
}

/** Row and column of a raster at a local position, as an index; -1 outside. */
function cellAt(grid, x, y) {
  const column = Math.floor((x - grid.x0) / grid.cell), row = grid.ny - 1 - Math.floor((y - grid.y0) / grid.cell);
  return column < 0 || row < 0 || column >= grid.nx || row >= grid.ny ? -1 : row * grid.nx + column;
}

/** The elevation of a raster between the centres of its cells, in its own steps; null where there is none. */
function elevationAt(grid, values, x, y) {
  const u = Math.max(0, Math.min(grid.nx - 1, (x - grid.x0) / grid.cell - .5));
  const v = Math.max(0, Math.min(grid.ny - 1, grid.ny - .5 - (y - grid.y0) / grid.cell));
  if (cellAt(grid, x, y) < 0) return null;
  const column = Math.min(Math.floor(u), Math.max(grid.nx - 2, 0)), row = Math.min(Math.floor(v), Math.max(grid.ny - 2, 0));
  let sum = 0;
  for (const [r, c, weight] of [[0, 0, (1 - v + row) * (1 - u + column)], [0, 1, (1 - v + row) * (u - column)],
    [1, 0, (v - row) * (1 - u + column)], [1, 1, (v - row) * (u - column)]]) {
    if (weight <= 0) continue;
    const value = values[(row + r) * grid.nx + column + c];
    if (value === 65535) return null;
    sum += weight * value;
  }
  return sum;
}

const RAMPS = {
  height: [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]],
  doubt: [[255, 255, 255], [254, 217, 118], [253, 141, 60], [227, 26, 28], [128, 0, 38]],
  elevation: [[47, 101, 76], [132, 166, 96], [226, 208, 147], [169, 120, 80], [245, 245, 245]],
};

/** 256 colours of a ramp, three bytes each. */
function rampTable(name) {
  const stops = RAMPS[name], out = new Uint8Array(768);
  for (let i = 0; i < 256; i++) {
    const at = i / 255 * (stops.length - 1), k = Math.min(Math.floor(at), stops.length - 2);
    for (let c = 0; c < 3; c++) out[3 * i + c] = Math.round(stops[k][c] + (at - k) * (stops[k + 1][c] - stops[k][c]));
  }
  return out;
}

/** The value below which a share of the values lies, those equal to none left out. */
function percentile(values, share, none) {
  const counts = new Uint32Array(65536);
  let known = 0;
  for (let i = 0; i < values.length; i++) if (values[i] !== none) { counts[values[i]]++; known++; }
  let below = 0;
  for (let v = 0; v < 65536; v++) { below += counts[v]; if (below >= share * known && known) return v; }
  return 0;
}

/** RGBA of a raster: values over the relief, or the relief alone for layer "shade". */
function pixels(layer, rasters, scale) {
  const {shade} = rasters, n = shade.length, out = new Uint8ClampedArray(4 * n);
  const table = RAMPS[layer] ? rampTable(layer) : null, values = rasters[layer];
  const none = layer === "doubt" ? 255 : 65535;
  for (let i = 0; i < n; i++) {
    let light = shade[i], r = light, g = light, b = light;
    const value = values ? values[i] : 0;
    if (table && value !== none) {
      const k = 3 * Math.max(0, Math.min(255, Math.round((value - scale[0]) / (scale[1] - scale[0] || 1) * 255)));
      if (!light) light = 180;
      const soft = layer === "doubt" ? .35 + .65 * light / 255 : .55 + .45 * light / 255;
      r = table[k] * soft; g = table[k + 1] * soft; b = table[k + 2] * soft;
    } else if (layer === "errors" && value) {
      [r, g, b] = value === 1 ? [213, 94, 0] : value === 2 ? [0, 114, 178] : [204, 121, 167];
    } else if (!light) continue;
    out[4 * i] = r; out[4 * i + 1] = g; out[4 * i + 2] = b; out[4 * i + 3] = 255;
  }
  return out;
}

/** Round numbers between two values, about so many. */
function ticks(low, high, about) {
  const rough = (high - low) / about || 1, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(f => f * power).find(s => s >= rough), out = [];
  for (let v = Math.ceil(low / step) * step; v <= high + step * 1e-9; v += step) out.push(Math.abs(v) < step * 1e-9 ? 0 : v);
  return {values: out, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9))};
}
