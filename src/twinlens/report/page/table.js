// The leaderboard: table, rules, failures, methods x samples, error against time.

const rules = () => byName(data.protocols, state.protocol);
const shownColumns = () => [...(state.columns === "all" ? rules().metrics : rules().columns), ...(state.columns === "all" ? data.times : ["time/MP"])];

function sortBy(metric) {
  state.flipped = state.sort === metric ? !state.flipped : false;
  state.sort = metric;
  drawBoard();
}

function ranked(over) {
  const rows = data.methods.map((m) => ({ method: m, scores: scoresOf(m.name, over) }));
  const order = compareBy(state.sort, state.flipped);
  return rows.sort((a, b) => order(a.scores.value(state.sort), b.scores.value(state.sort)));
}

function headCell(metric) {
  const m = data.metrics[metric], on = state.sort === metric;
  const up = m.lower !== state.flipped;
  return el("th", { scope: "col", "aria-sort": on ? (up ? "ascending" : "descending") : "none" },
    el("button", { type: "button", title: `${m.text} [${m.unit}], ${m.lower ? "lower" : "higher"} is better`, onclick: () => sortBy(metric) },
      on ? el("span", { class: "arrow", "aria-hidden": "true" }, up ? "↑" : "↓") : null, metric, el("small", {}, m.unit)));
}

function drawBoard() {
  const columns = shownColumns();
  if (!columns.includes(state.sort)) { state.sort = rules().headline; state.flipped = false; }
  const rows = ranked(state.over);
  const best = Object.fromEntries(columns.map((c) => {
    const values = rows.map((r) => r.scores.value(c)).filter((v) => !Number.isNaN(v));
    const tied = values.length > 1 && values.every((v) => v === values[0]);
    return [c, values.length && !tied ? values.reduce((a, b) => (data.metrics[c].lower ? Math.min(a, b) : Math.max(a, b))) : NaN];
  }));
  const largest = Math.max(...rows.map((r) => r.scores.value(state.sort)).filter(Number.isFinite), 1e-12);
  $("board").replaceChildren(
    el("thead", {}, el("tr", {}, el("th", { class: "name", scope: "col" }, "Method"), columns.map(headCell))),
    el("tbody", {}, rows.map((row, i) => boardRow(row, i, columns, best, largest))));
  drawGroups();
  drawRules();
  drawMatrix();
  drawDisagreement();
  drawScatter();
  drawSparsification();
}

function boardRow({ method, scores }, i, columns, best, largest) {
  const why = scores.failure ? scores.failure.join(": ") : [
    ...scores.failed.map((s) => `${s}: ${(entryOf(method.name, s).failure || []).join(": ")}`),
    ...scores.missing.map((s) => `${s}: not run`)].join("\n");
  const open = () => { look(overSample() || state.sample, method.name); };
  return el("tr", { tabindex: "0", "aria-selected": String(method.name === state.method), onclick: open, onkeydown: pressed(open) },
    el("td", { class: "name", title: method.spec },
      el("span", { class: "rank" }, Number.isNaN(scores.value(state.sort)) ? "" : String(i + 1)), breakable(method.name),
      whyNot(scores) ? el("span", { class: "fail", title: why }, whyNot(scores)) : null),
    columns.map((c) => {
      const v = scores.value(c), on = c === state.sort;
      return el("td", { class: `${on ? "sorted" : ""} ${v === best[c] ? "best" : ""}`, "--share": on && Number.isFinite(v) ? `${(100 * v) / largest}%` : "0%" }, show(c, v));
    }));
}

// Why a row has no numbers: a method that failed or was not run on a sample has no mean.
function whyNot({ failure, failed, missing, n }) {
  if (failure) return failure[0];
  if (!failed.length && !missing.length) return "";
  return `${n} of ${counted(n + failed.length + missing.length, "sample")}${failed.length ? `, ${failed.length} failed` : ""}`;
}

// How many samples of a group the selected protocol scores.
const scored = (group) => group.samples.filter((name) => rules().samples.includes(name)).length;

// The headline metric, one column for each group of samples that the protocol scores, and differences from the first.
function drawGroups() {
  const shown = titled.length ? titled : groups.filter((g) => g.by === state.by && scored(g));
  $("groups-card").hidden = !titled.length && shown.length < 2;
  if ($("groups-card").hidden || !state.region) return;
  const metric = rules().headline, order = compareBy(metric, false), m = data.metrics[metric];
  const values = data.methods.map((method) => [method.name, shown.map((g) => scoresOf(method.name, g.key).value(metric))]);
  const best = shown.map((_, k) => values.map((row) => row[1][k]).sort(order)[0]);
  const compared = shown.filter(gapsOf);
  $("groups-title").textContent = `${metric} [${m.unit}], ${state.region}${state.by && `, by ${state.by}`}: ${m.text}`;
  $("groups").replaceChildren(
    el("thead", {}, el("tr", {}, el("th", { class: "name", scope: "col" }, "Method"), shown.map((g) => el("th", { scope: "col", title: g.samples.join(", ") }, g.name, el("small", {}, counted(scored(g), "sample")))),
      compared.map((g) => el("th", { scope: "col" }, `${g.name} − ${shown[0].name}`, el("small", {}, gapsOf(g).basis))))),
    el("tbody", {}, values.sort((a, b) => order(a[1][0], b[1][0])).map(([name, row]) => el("tr", {}, el("td", { class: "name" }, breakable(name)),
      row.map((v, k) => el("td", { class: v === best[k] ? "best" : "" }, show(metric, v))), compared.map((g) => gapCell(metric, gapsOf(g).methods[name]))))));
  const about = compared.length ? [`${data.differences}. Coloured: the interval, not a range, excludes 0.`] : [];
  $("notes").replaceChildren(...[...about, ...data.notes].map((text) => el("p", {}, text)));
}

// A group's differences by the selected protocol and region; undefined for the first group, which has none.
const gapsOf = (group) => group.gaps && group.gaps[state.protocol] && group.gaps[state.protocol][state.region];

const signed = (metric, v) => `${v > 0 ? "+" : v < 0 ? "−" : ""}${show(metric, Math.abs(v))}`;

function gapCell(metric, [value, low, high, scenes, basis]) {
  if (value == null) return el("td", { title: "a method that failed on a sample of a group has no mean" }, "–");
  if (low == null) return el("td", { title: basis }, signed(metric, value));
  const isRange = scenes < data.min_units, lowest = signed(metric, low), highest = signed(metric, high);
  const ends = isRange ? ` (range of ${scenes}: ${lowest} to ${highest})` : ` [${lowest}, ${highest}]`;
  const certain = !isRange && (low > 0 || high < 0), better = data.metrics[metric].lower ? value < 0 : value > 0;
  return el("td", { class: certain ? (better ? "gain" : "loss") : "", title: basis }, signed(metric, value), el("small", {}, ends));
}

function drawRules() {
  const region = byName(data.regions, state.region);
  const lines = { ...rules().lines };
  if (region) lines.region = `${region.name}: ${region.text || "defined by the caller"}`;
  const group = groupOf(state.over), sample = overSample();
  if (!sample) lines.mean = `${data.weighted ? "weighted" : "plain"} mean over ${group ? (group.by ? `the ${counted(group.samples.length, "sample")} of ${group.key}` : group.samples.join(", ")) : "samples"}; none if a method failed or was not run on a sample`;
  $("rules").replaceChildren(...Object.entries(lines).flatMap(([k, v]) => [el("dt", {}, k), el("dd", {}, v)]));
  const counts = sample ? data.methods.map((m) => scoresOf(m.name, sample).counts).find(Boolean) : null;
  if (!region) { $("counts").textContent = "Nothing was scored."; drawFailures(); return; }
  const n = sample ? 0 : Math.max(...data.methods.map((m) => scoresOf(m.name, state.over).n), 0);
  $("counts").textContent = counts ? `${counts[1].toLocaleString("en")} of ${counts[0].toLocaleString("en")} pixels are evaluated in this region.`
    : sample ? "No pixel of this sample is in this region." : `${n} of ${counted((group ? group.samples : rules().samples).length, "sample")} ${have(n)} pixels in this region. Click a row to inspect its maps.`;
  drawFailures();
}

// One line for each method and reason, with the samples concerned, and the last calls of an exception below it.
// Protocols share their failures. Messages that differ in numbers only, such as times, are one reason.
function drawFailures() {
  $("doubts").replaceChildren(...data.doubts.map((text) => el("p", {}, el("span", { class: "fail" }, "doubtful"), ` ${text}`)));
  const reasons = new Map();
  for (const e of data.entries.filter((e) => e.failure)) {
    const [kind, message] = e.failure;
    const key = JSON.stringify([e.method, kind, message.replace(/[0-9.]+/g, "#")]);
    if (!reasons.has(key)) reasons.set(key, { entry: e, samples: new Set() });
    reasons.get(key).samples.add(e.sample);
  }
  $("failed").replaceChildren(...[...reasons.values()].flatMap(({ entry, samples }) => {
    const [kind, message] = entry.failure;
    const where = samples.size === data.samples.length && samples.size > 1 ? "every sample" : [...samples].join(", ");
    const line = el("p", {}, el("span", { class: "fail" }, kind), el("b", {}, ` ${entry.method}`), ` on ${where}: ${message}`);
    return entry.frames.length ? [line, el("pre", {}, entry.frames.join("\n"))] : [line];
  }));
}

const tint = (better) => `color-mix(in srgb, var(--accent) ${Math.round(6 + 46 * better)}%, transparent)`;

function shade(value, low, high) {
  if (!Number.isFinite(value)) return "transparent";
  const share = high > low ? (value - low) / (high - low) : 0;
  return tint(data.metrics[state.sort].lower ? 1 - share : share);
}

// Colour scale of one sample's column: samples differ in difficulty.
function scale(values) {
  if (!values.length) return "–";
  const ends = [Math.min(...values), Math.max(...values)], [best, worst] = data.metrics[state.sort].lower ? ends : ends.reverse();
  const bar = el("div", { class: "scale", style: `background:linear-gradient(90deg, ${tint(1)}, ${tint(0)})` });
  const numbers = best === worst ? el("span", {}, show(state.sort, best)) : [el("span", {}, show(state.sort, best)), el("span", {}, show(state.sort, worst))];
  if (best === worst) bar.style.background = shade(best, best, worst);
  return [bar, el("div", { class: "ends" }, numbers)];
}

// The cells are one tab stop; arrow keys move between them.
const walk = (open) => (event) => {
  const cell = event.currentTarget, row = cell.parentElement, at = [...row.children].indexOf(cell);
  const beside = (r) => r && r.children[at];
  const next = { ArrowRight: cell.nextElementSibling, ArrowLeft: at > 1 ? cell.previousElementSibling : null,
    ArrowDown: beside(row.nextElementSibling), ArrowUp: beside(row.previousElementSibling) };
  if (!(event.key in next)) { pressed(open)(event); return; }
  event.preventDefault();
  if (!next[event.key]) return;
  cell.tabIndex = -1;
  next[event.key].tabIndex = 0;
  next[event.key].focus();
};

function drawMatrix() {
  const m = data.metrics[state.sort];
  $("matrix-title").textContent = `${state.sort} [${m.unit}] on each sample${state.region && `, ${state.region}`}`;
  const group = groupOf(state.over), rows = ranked(group ? state.over : "");
  const samples = samplesOf(rules()).filter((s) => !group || !group.by || group.samples.includes(s.name));
  const cells = rows.map((r) => samples.map((s) => scoresOf(r.method.name, s.name)));
  const limits = samples.map((_, k) => cells.map((row) => row[k].value(state.sort)).filter(Number.isFinite));
  $("matrix").replaceChildren(
    el("thead", {}, el("tr", {}, el("th", { class: "name" }), samples.map((s) => el("th", { title: s.name }, s.name.length > 48 ? `${s.name.slice(0, 47)}…` : s.name, el("small", {}, `ndisp ${s.ndisp}`))))),
    el("tbody", {}, rows.map((r, i) => el("tr", {}, el("td", { class: "name", title: r.method.spec }, breakable(r.method.name)),
      samples.map((s, k) => {
        const c = cells[i][k], v = c.value(state.sort), open = () => look(s.name, r.method.name);
        return el("td", { class: "cell", tabindex: i || k ? "-1" : "0", onkeydown: walk(open), style: `background:${shade(v, Math.min(...limits[k]), Math.max(...limits[k]))}`, title: c.failure ? c.failure.join(": ") : `${r.method.name} on ${s.name}`, onclick: open },
          c.failure ? el("span", { class: "fail" }, c.failure[0]) : show(state.sort, v));
      })))),
    el("tfoot", {}, el("tr", {}, el("td", { class: "name" }, "Colours, best to worst"), limits.map((values) => el("td", { class: "limits" }, scale(values))))));
}

// Of two methods, the share of pixels where their estimates are apart: the mean over the selected samples.
function drawDisagreement() {
  const samples = overSample() ? [state.over] : (groupOf(state.over) || rules()).samples;
  const pairs = rules().truth ? [] : data.disagreements.filter((d) => samples.includes(d.sample));
  $("apart-card").hidden = !pairs.length;
  if (!pairs.length) return;
  const names = ranked(state.over).map((r) => r.method.name).filter((name) => pairs.some((d) => d.first === name || d.second === name));
  const shareOf = (a, b) => {
    const shares = pairs.filter((d) => (d.first === a && d.second === b) || (d.first === b && d.second === a)).map((d) => number(d.apart)).filter(Number.isFinite);
    return shares.length ? shares.reduce((sum, v) => sum + v, 0) / shares.length : NaN;
  };
  const text = (a, b) => (a === b ? "" : Number.isNaN(shareOf(a, b)) ? "–" : shareOf(a, b).toFixed(2));
  const open = (a, b) => { state.first = a; state.second = b; redraw(); $("compare").scrollIntoView(); };
  const shares = names.flatMap((a) => names.map((b) => (a === b ? NaN : shareOf(a, b)))).filter(Number.isFinite);
  const largest = Math.max(...shares, 1e-9);
  const cell = (a, b) => el("td", { class: "cell", tabindex: "0", title: `${a} and ${b}`, style: a === b ? "" : `background:${tint((shareOf(a, b) || 0) / largest)}`,
    onclick: () => open(a, b), onkeydown: pressed(() => open(a, b)) }, text(a, b));
  $("apart-title").textContent = `Disagreement: % of the pixels with both estimates that are more than ${data.agree_px} px apart; the darker, the more`;
  $("apart").replaceChildren(
    el("thead", {}, el("tr", {}, el("th", { class: "name" }), names.map((name) => el("th", { scope: "col" }, breakable(name))))),
    el("tbody", {}, names.map((a) => el("tr", {}, el("td", { class: "name" }, breakable(a)), names.map((b) => cell(a, b))))));
}

// Round numbers on a logarithmic axis: the coarsest choice with at least three ticks.
function ticks(low, high) {
  const decades = Array.from({ length: Math.ceil(Math.log10(high)) - Math.floor(Math.log10(low)) + 1 }, (_, i) => 10 ** (Math.floor(Math.log10(low)) + i));
  const choices = [[1], [1, 3], [1, 2, 5], [1, 1.5, 2, 3, 4, 5, 7]].map((steps) => decades.flatMap((d) => steps.map((s) => s * d)).filter((t) => t >= low && t <= high));
  return choices.find((c) => c.length >= 3) || choices[choices.length - 1];
}

// Each label takes the first position next to its dot where it covers no dot, label or edge; otherwise it is omitted.
function labels(dots, width, floor) {
  const taken = dots.map((d) => [d.x - 6, d.y - 6, d.x + 6, d.y + 6]);
  const free = (box) => box[0] > 0 && box[2] < width && box[3] < floor && !taken.some((t) => box[0] < t[2] && box[2] > t[0] && box[1] < t[3] && box[3] > t[1]);
  return dots.map((d) => {
    const w = 6.9 * d.text.length + 4;
    const places = [[10, 4], [-10 - w, 4], [-w / 2, -11], [-w / 2, 20], [8, -9], [8, 18], [-8 - w, -9], [-8 - w, 18], [-w / 2, -24], [-w / 2, 33]];
    const box = ([dx, dy]) => [d.x + dx, d.y + dy - 11, d.x + dx + w, d.y + dy + 2];
    const place = places.find((p) => free(box(p)));
    if (!place) return null; // the dot has a tooltip
    taken.push(box(place));
    return el("text", { class: "tag", x: d.x + place[0], y: d.y + place[1] }, d.text);
  });
}

function drawScatter() {
  const y = data.times.includes(state.sort) ? rules().headline : state.sort, x = "time/MP";
  $("scatter-title").textContent = `${y} [${data.metrics[y].unit}] against time [${data.metrics[x].unit}]`;
  const dots = data.methods.map((m) => ({ name: m.name, s: scoresOf(m.name, state.over) }))
    .map((d) => ({ name: d.name, x: d.s.value(x), y: d.s.value(y) })).filter((d) => d.x > 0 && Number.isFinite(d.y));
  if (!dots.length) { $("scatter").replaceChildren(el("p", { class: "empty" }, "No times were measured.")); return; }
  const W = Math.max(300, Math.min(760, $("scatter").clientWidth || 560)), H = 300, left = 46, right = 20, bottom = 34, top = 12;
  const low = Math.min(...dots.map((d) => d.x)) / 1.6, high = Math.max(...dots.map((d) => d.x)) * 1.6;
  const peak = Math.max(...dots.map((d) => d.y), 1e-9) * 1.12;
  const px = (v) => left + ((W - left - right) * Math.log(v / low)) / Math.log(high / low);
  const py = (v) => H - bottom - ((H - bottom - top) * v) / peak;
  const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((s) => peak / s <= 6) || peak / 4;
  const levels = Array.from({ length: Math.floor(peak / step) + 1 }, (_, i) => i * step);
  const tags = labels(dots.map((d) => ({ x: px(d.x), y: py(d.y), text: d.name.length > 26 ? `${d.name.slice(0, 25)}…` : d.name })), W, H - bottom + 8);
  $("scatter").replaceChildren(el("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": $("scatter-title").textContent },
    levels.map((v) => [el("line", { class: "grid", x1: left, x2: W - right, y1: py(v), y2: py(v) }), el("text", { x: left - 8, y: py(v) + 4, "text-anchor": "end" }, String(+v.toPrecision(3)))]).flat(),
    ticks(low, high).map((t) => el("text", { x: px(t), y: H - 12, "text-anchor": "middle" }, String(+t.toPrecision(2)))),
    tags,
    dots.map((d) => el("circle", { class: d.name === state.method ? "dot on" : "dot", cx: px(d.x), cy: py(d.y), r: 5.5, onclick: () => look(overSample() || state.sample, d.name) },
      el("title", {}, `${d.name}: ${show(y, d.y)} ${data.metrics[y].unit}, ${show(x, d.x)} ${data.metrics[x].unit}`)))));
}

const lineColours = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7a5195", "#8c6d31"];

// The mean of a method's sparsification curves over the selected samples; null if one of them has none.
function sparsificationOf(method) {
  const group = groupOf(state.over);
  const samples = overSample() ? [state.over] : group ? group.samples : rules().samples;
  const regions = samples.map((s) => entryOf(method, s)).map((e) => e && e.regions[state.region]);
  const curves = regions.filter((r) => !r || r.n[2]).map((r) => r && r.s);
  if (!curves.length || !curves.every(Boolean)) return null;
  const mean = (rates) => rates.reduce((a, b) => a + b, 0) / rates.length;
  const last = curves.map((c) => c[c.length - 1] / 100);
  return { name: method, rates: data.densities.map((_, k) => mean(curves.map((c) => c[k]))),
    best: data.densities.map((x) => 100 * mean(last.map((e) => Math.max(0, 1 - (1 - e) / x)))) };
}

// Error rate of the most confident pixels against their share; dashed: the lowest possible one of the selected method.
function drawSparsification() {
  const curves = data.methods.map((m) => sparsificationOf(m.name)).filter(Boolean);
  $("sparse-card").hidden = !curves.length;
  if (!curves.length) return;
  const area = rules().metrics.find((m) => m.startsWith("auc"));
  $("sparse-title").textContent = `Sparsification: errors above ${parseFloat(area.slice(3))} px [%] among the most confident pixels, ${state.region}`;
  const W = Math.max(300, Math.min(1200, $("sparse").clientWidth || 760)), H = 300, left = 46, right = 20, bottom = 34, top = 12;
  const peak = 1.06 * Math.max(...curves.flatMap((c) => c.rates), 1e-9);
  const px = (x) => left + (W - left - right) * x, py = (v) => H - bottom - ((H - bottom - top) * v) / peak;
  const step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((s) => peak / s <= 6) || 50;
  const levels = Array.from({ length: Math.floor(peak / step) + 1 }, (_, i) => i * step);
  const line = (rates, colour, extra, text) => el("polyline", { class: `curve ${extra}`, stroke: colour, points: rates.map((v, k) => `${px(data.densities[k]).toFixed(1)},${py(v).toFixed(1)}`).join(" ") }, el("title", {}, text));
  const colours = new Map(curves.map((c, k) => [c.name, lineColours[k % lineColours.length]]));
  const chosen = curves.find((c) => c.name === state.method) || curves[0];
  $("sparse").replaceChildren(el("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": $("sparse-title").textContent },
    levels.map((v) => [el("line", { class: "grid", x1: left, x2: W - right, y1: py(v), y2: py(v) }), el("text", { x: left - 8, y: py(v) + 4, "text-anchor": "end" }, String(+v.toPrecision(3)))]).flat(),
    [0, 0.25, 0.5, 0.75, 1].map((x) => el("text", { x: px(x), y: H - 12, "text-anchor": "middle" }, `${100 * x}%`)),
    line(chosen.best, colours.get(chosen.name), "ideal", `lowest possible for ${chosen.name}`),
    curves.map((c) => line(c.rates, colours.get(c.name), c === chosen ? "on" : "", `${c.name}: ${area} ${show(area, scoresOf(c.name, state.over).value(area))} %`))),
  el("div", { class: "legend" }, curves.map((c) => el("span", { class: "key" }, el("i", { style: `background:${colours.get(c.name)}` }), c.name)),
    el("span", {}, `dashed: lowest possible for ${chosen.name}`)));
}

function drawControls() {
  segments($("protocols"), data.protocols.map((p) => [p.name, p.title]), state.protocol, (name) => { selectProtocol(name); redraw(); });
  options($("region"), rules().regions, state.region);
  const means = groups.filter((g) => !g.by || scored(g)).map((g) => [g.key, g.by ? `${g.key} (${counted(scored(g), "sample")})` : g.key]);
  if (!titled.length) means.unshift(["", `mean of ${counted(rules().samples.length, "sample")}`]);
  const choices = [...means, ...rules().samples.map((name) => [name, name])];
  options($("over"), choices.map((c) => c[0]), state.over, choices.map((c) => c[1]));
  const names = data.groupings.map((g) => g.by).filter(Boolean);
  $("by").parentElement.hidden = !names.length;
  options($("by"), ["", ...names], state.by, ["none", ...names]);
}
