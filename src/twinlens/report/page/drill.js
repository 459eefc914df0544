// One sample: images, truth, disparity and error maps, the comparison of two methods, and values under the pointer.

const sampleNow = () => byName(data.samples, state.sample);
const pixels = (value) => `${+value.toPrecision(4)} px`;
const MOST_GREY = 32; // end of the colours of residuals
let drawing = 0;

function look(sample, method) {
  if (sample) selectSample(sample);
  state.method = method || state.method;
  redraw();
  $("samples").scrollIntoView();
}

async function drawPanels() {
  const mine = ++drawing, sample = sampleNow(), p = sample && sample.pictures;
  options($("sample"), data.samples.map((s) => s.name), state.sample);
  options($("method"), data.methods.map((m) => m.name), state.method);
  segments($("ranges"), [1, 2, 4, 8, 16].map((r) => [r, `±${r}`]), state.range, (r) => { state.range = r; redraw(); });
  drawChips();
  if (!p) {
    $("panels").replaceChildren(el("p", { class: "card empty" }, "This page was written without the images of this sample."));
    $("versus").replaceChildren();
    $("maps-note").textContent = "";
    return;
  }
  const truth = p.truth && await mapOf(p.truth);
  const wanted = [state.method, state.first, state.second];
  const [est, a, b] = await Promise.all(wanted.map((m) => (p.maps[m] ? mapOf(p.maps[m]) : null)));
  const found = truth ? null : await checksOf(p, state.method);
  if (mine !== drawing) return;
  const views = truth ? viewsOf(sample, p, truth, est) : viewsWithoutTruth(sample, p, est, found);
  $("range-label").textContent = truth ? "Error range" : "Difference range";
  $("panels").replaceChildren(...views);
  $("versus").replaceChildren(...(truth ? versusOf(p, truth, a, b) : versusWithoutTruth(p, a, b)));
  follow([...views, ...$("versus").children], p, truth, { est, a, b, ...found });
  const thin = p.stride > 1 ? `Every ${ordinal(p.stride)} pixel is shown. ` : "";
  const meaning = truth ? "Signed error = estimate − truth." : "Left-right difference = |left estimate − right map’s estimate at its match|. Residual = |left − right image at u − d|, grey levels of 0..255.";
  $("maps-note").textContent = `Click a pixel for its costs. ${thin}Maps are stored in steps of 1/16 px; scores are computed from the full maps. ${meaning}`;
}

const caption = (text) => el("div", { class: "legend" }, text);
const image = (uri, text) => el("img", { src: uri, alt: text });
const missing = (name) => el("figure", { class: "card panel" }, el("figcaption", {}, el("span", {}, name)), el("p", { class: "empty" }, whyMissing(name)));

function whyMissing(method) {
  const entry = entryOf(method, state.sample);
  if (entry && entry.failure) return `${entry.failure[0]}: ${entry.failure[1]}`;
  return entry ? "Its map is not available." : "Not run on this sample.";
}

// Maps of a sample without truth: of the method, its difference from its right map and its residual; of all methods, where they disagree.
async function checksOf(p, method) {
  const packed = [(p.differences || {})[method], (p.residuals || {})[method]];
  const [gap, residual] = await Promise.all(packed.map((m) => (m ? mapOf(m) : null)));
  const maps = await Promise.all(Object.values(p.maps).map(mapOf));
  if (maps.length > 1 && !p.disagreement) p.disagreement = disagreementOf(maps);
  return { gap, residual, disagreement: p.disagreement };
}

function imagesOf(sample, p, match) {
  const views = [
    panel("Left image", [`${sample.w} × ${sample.h}`, p.noise].filter(Boolean).join(", "), image(p.left, "left image"), caption("The view whose disparity is shown.")),
    panel("Right image", `ndisp ${sample.ndisp}`, image(p.right, "right image"), caption(`The cross marks the ${match}.`)),
  ];
  views[1].querySelector(".view").dataset.right = "1";
  return views;
}

function viewsWithoutTruth(sample, p, est, { gap, residual, disagreement }) {
  const { w, h } = p, range = p.range, e = state.range;
  const views = imagesOf(sample, p, "match of the estimate");
  if (est) views.push(panel("Disparity", state.method, paint(w, h, painters.disparity(est, range, noEstimate)), legend("viridis", range[0], pixels(range[1]), ["estimate"])));
  else views.push(missing(state.method));
  if (est && gap) views.push(panel("Left-right difference", state.method, paint(w, h, checks.difference(est, gap, e)), legend("magma", 0, `≥ ${e} px`, ["estimate", "match"])));
  if (est && residual) views.push(panel("Photometric residual", state.method, paint(w, h, checks.difference(est, residual, MOST_GREY)), legend("magma", 0, `≥ ${MOST_GREY} grey`, ["estimate", "match"])));
  if (disagreement) views.push(panel("Disagreement", "all methods", paint(w, h, checks.disagreement(disagreement)), legend("magma", 0, "100 % of the pairs of methods", ["pair"])));
  return views;
}

function versusWithoutTruth(p, a, b) {
  const { w, h } = p, e = state.range;
  const one = (name, est, letter) => (est ? panel(`${letter} · ${name}`, "disparity", paint(w, h, painters.disparity(est, p.range, noEstimate)),
    legend("viridis", p.range[0], pixels(p.range[1]), ["estimate"])) : missing(name));
  const both = a && b ? [panel("A − B", "disparity", paint(w, h, checks.apart(a, b, e)), legend("berlin", `≤ −${e}`, `≥ +${e} px`, ["estimate"]))] : [];
  return [one(state.first, a, "A"), one(state.second, b, "B"), ...both];
}

function viewsOf(sample, p, truth, est) {
  const { w, h } = p, range = p.range, e = state.range;
  const views = [
    ...imagesOf(sample, p, "true corresponding point"),
    panel("True disparity", "", paint(w, h, painters.disparity(truth, range, noTruth)), legend("viridis", range[0], pixels(range[1]), ["truth"])),
  ];
  if (!est) return [...views, missing(state.method)];
  return [...views,
    panel("Disparity", state.method, paint(w, h, painters.disparity(est, range, noEstimate)), legend("viridis", range[0], pixels(range[1]), ["estimate"])),
    panel("|Error|", state.method, paint(w, h, painters.size(est, truth, e)), legend("magma", 0, `≥ ${e} px`, ["estimate", "truth"])),
    panel("Signed error", state.method, paint(w, h, painters.signed(est, truth, e)), legend("berlin", `≤ −${e}`, `≥ +${e} px`, ["estimate", "truth"]))];
}

function versusOf(p, truth, a, b) {
  const { w, h } = p, e = state.range;
  const one = (name, est, letter) => (est ? panel(`${letter} · ${name}`, "signed error", paint(w, h, painters.signed(est, truth, e)),
    legend("berlin", `≤ −${e}`, `≥ +${e} px`, ["estimate", "truth"])) : missing(name));
  const both = a && b ? [panel("Smaller error", "|error A| − |error B|", paint(w, h, painters.closer(a, b, truth, e)),
    legend("berlin", `A by ${e} px`, `B by ${e} px`, ["estimate", "truth"]))] : [];
  return [one(state.first, a, "A"), one(state.second, b, "B"), ...both];
}

// The pointer moves a cross on every view; on the right image the cross marks the true corresponding point or, without
// truth, that of the estimate.
function follow(figures, p, truth, maps) {
  const views = figures.flatMap((f) => [...f.querySelectorAll(".view")]);
  const { w, h, stride } = p;
  const place = (event) => {
    const box = event.currentTarget.getBoundingClientRect();
    return [clamped(Math.floor(((event.clientX - box.left) / box.width) * w), w), clamped(Math.floor(((event.clientY - box.top) / box.height) * h), h)];
  };
  const pick = (event) => { const [x, y] = place(event); pickPixel(x * stride, y * stride); };
  const move = (event) => {
    const [x, y] = place(event);
    const i = y * w + x, matched = truth || maps.est, d = matched ? matched[i] : Infinity;
    for (const view of views) {
      const shift = view.dataset.right && d !== Infinity ? d / stride : 0;
      view.classList.add("pointed");
      view.style.setProperty("--x", `${(100 * (x + 0.5 - shift)) / w}%`);
      view.style.setProperty("--y", `${(100 * (y + 0.5)) / h}%`);
    }
    const est = maps.est && maps.est[i];
    const value = est == null || est === Infinity ? "no estimate" : `${est.toFixed(2)} px`;
    $("readout").textContent = `x ${x * stride}  y ${y * stride}:  ${truth ? readTruth(est, d, value) : readChecks(value, maps, i)}`;
  };
  const leave = () => views.forEach((view) => view.classList.remove("pointed"));
  views.forEach((view) => { view.addEventListener("pointermove", move); view.addEventListener("pointerleave", leave); view.addEventListener("click", pick); });
}

function readTruth(est, d, value) {
  const off = est != null && est !== Infinity && d !== Infinity ? `, error ${est - d >= 0 ? "+" : "−"}${Math.abs(est - d).toFixed(2)}` : "";
  return `truth ${d === Infinity ? "unknown" : `${d.toFixed(2)} px`}, ${value}${off}`;
}

function readChecks(value, { gap, residual }, i) {
  const has = (values) => values && values[i] !== Infinity;
  return [value, has(gap) ? `left-right ${gap[i].toFixed(2)} px` : "", has(residual) ? `residual ${residual[i].toFixed(1)}` : ""].filter(Boolean).join(", ");
}

function drawChips() {
  const scores = scoresOf(state.method, state.sample);
  if (scores.failure) { $("numbers").replaceChildren(el("span", { class: "fail" }, scores.failure.join(": "))); return; }
  $("numbers").replaceChildren(...shownColumns().map((c) =>
    el("div", { class: "chip", title: data.metrics[c].text }, el("span", {}, c), el("b", {}, show(c, scores.value(c))), ` ${data.metrics[c].unit}`)));
}

function drawCompare() {
  const names = data.methods.map((m) => m.name);
  options($("first"), names, state.first);
  options($("second"), names, state.second);
  const a = scoresOf(state.first, state.over), b = scoresOf(state.second, state.over);
  const head = ["Metric", "A", "B", "B − A"].map((t, i) => el("th", { class: i ? "" : "name" }, t));
  $("difference").replaceChildren(el("thead", {}, el("tr", {}, head)), el("tbody", {}, shownColumns().map((c) => {
    const va = a.value(c), vb = b.value(c), gap = vb - va, better = data.metrics[c].lower ? gap < 0 : gap > 0;
    return el("tr", {}, el("td", { class: "name", title: data.metrics[c].text }, `${c} [${data.metrics[c].unit}]`),
      el("td", {}, show(c, va)), el("td", {}, show(c, vb)), el("td", { class: gap === 0 || !Number.isFinite(gap) ? "" : better ? "gain" : "loss" }, showGap(c, va, vb)));
  })));
}

function redraw() {
  drawControls();
  drawBoard();
  drawCompare();
  return Promise.all([drawPanels(), drawWhy()]);
}

// What is said of samples without truth.
function blindNote() {
  const scored = new Set(data.protocols.filter((p) => p.truth).flatMap((p) => p.samples));
  const blind = data.samples.filter((s) => !scored.has(s.name)).length;
  if (!blind) return "";
  const which = blind === data.samples.length ? "No pair has" : blind === 1 ? "1 pair has no" : `${blind} pairs have no`;
  return ` ${which} true disparity: maps are compared with the right view's and with each other, and nothing here is an error.`;
}

function start() {
  setTheme(firstTheme());
  $("theme").addEventListener("click", () => setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  const sizes = `${counted(data.methods.length, "method")} on ${counted(data.samples.length, "stereo pair")}`;
  $("summary").textContent = `${sizes}, scored by ${data.protocols.map((p) => p.title).join(", ")}.${blindNote()}`;
  $("made").textContent = Object.entries(data.meta).map(([k, v]) => `${k} ${v}`).join(" · ");
  $("groups-card").hidden = true;
  if (!data.entries.length) { $("board").replaceChildren(el("tr", {}, el("td", { class: "empty" }, "The board is empty."))); return; }
  state.sort = rules().headline;
  const order = ranked(state.over).map((r) => r.method.name);
  state.method = state.first = order[0];
  state.second = order[1] || order[0];
  state.sample = (data.samples.find((s) => s.pictures) || data.samples[0]).name;
  for (const id of ["region", "over", "by", "columns", "sample", "method", "first", "second"])
    $(id).addEventListener("change", (event) => { state[id] = event.target.value; if (id === "sample") { state.pixel = null; selectSample(state.sample); } redraw(); });
  for (const id of ["at-u", "at-v"])
    $(id).addEventListener("change", () => pickPixel(Number($("at-u").value), Number($("at-v").value)));
  $("over").addEventListener("change", () => { if (overSample()) { selectSample(state.over); redraw(); } });
  $("get-csv").addEventListener("click", () => save("board.csv", "text/csv", data.downloads.csv));
  $("get-json").addEventListener("click", () => save("board.json", "application/json", data.downloads.json));
  $("get-latex").disabled = !state.region;
  $("get-latex").addEventListener("click", () => save("board.tex", "application/x-tex", data.downloads.latex[state.protocol][state.region]));
  redraw().then(() => { document.documentElement.dataset.ready = "1"; });
}

start();
