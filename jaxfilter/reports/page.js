// The page: its state, slider, figures and tables, and how all begins. data.js, map.js and profile.js share its scope.

const el = id => document.getElementById(id);
const facts = JSON.parse(el("facts").textContent);
const number = (value, digits = 0) => value === null || value === undefined ? "undefined"
  : value.toLocaleString("en", {minimumFractionDigits: digits, maximumFractionDigits: digits});
const state = {
  step: facts.step, layer: "shade", points: facts.scores ? "errors" : "labels", line: [], drawing: false, ready: false,
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
    [facts.class_names[old], old === next ? "kept" : facts.class_names[next], number(counts[k])]);
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

function listPlaces() {
  const {places} = facts;
  if (!places.length) return;
  el("places-section").hidden = false;
  const errors = places[0].what === "errors";
  el("places-hint").textContent = errors ? "Squares with most cells in error." : "Places where the terrain may be wrong, largest expected error volume first.";
  el("places").replaceChildren(...places.map((place, i) => {
    const button = document.createElement("button"), reach = .7 * place.side;
    button.type = "button";
    button.textContent = `${i + 1} · ${toFile([place.x, place.y]).map(v => number(v)).join(", ")}`;
    if (!errors) button.textContent += ` · ${place.what}`;
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
  el("points").value = state.points;
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
