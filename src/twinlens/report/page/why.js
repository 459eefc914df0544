// A clicked pixel: for each method its cost as a function of disparity, its windows, and why it is right or wrong.

const prepared = new Map(); // pictures -> their grey images, plain and prefiltered

async function greyOf(p) {
  if (!prepared.has(p)) prepared.set(p, Promise.all(p.grey.map(unpackGrey)).then((plain) => ({ plain, slopes: null })));
  return prepared.get(p);
}

function imagesFor(method, pair) {
  if (method.prefilter !== "xsobel") return pair.plain;
  pair.slopes ||= pair.plain.map(clippedSlope);
  return pair.slopes;
}

const around = (img, x, y, r) => windowOf(img, x, y, 2 * r + 1);

// The mean square of horizontal differences in the window of radius r, in grey levels of 0..255.
function texture(img, x, y, r) {
  let total = 0;
  for (let v = y - r; v <= y + r; v++) for (let u = x - r; u <= x + r; u++) total += ((grey(img, u + 1, v) - grey(img, u, v)) * 255 / img.top) ** 2;
  return total / (2 * r + 1) ** 2;
}

// The same over the variance of the window: blur lowers it, gain does not change it.
function sharpness(img, x, y, r) {
  const a = centred(around(img, x, y, r).map((v) => (v * 255) / img.top));
  return texture(img, x, y, r) / (measures.ssd(a, a.map(() => 0)) / a.length);
}

// Why the estimate of pixel (x, y) is right or wrong: a kind and a sentence. truth: {w, h, stride, values, hidden}.
// The rule is that of twinlens.scoring.reasons; data.limits are its LIMITS.
function reasonOf({ x, y, radius, est, low, count, costs, truth, left, right }) {
  const { stride } = truth, limits = data.limits, at = (u, v) => truth.values[v * truth.w + u];
  const tx = Math.round(x / stride), ty = Math.round(y / stride), d = at(tx, ty);
  if (d === Infinity) return ["unknown", "The truth is unknown here."];
  const off = est - d, none = est === Infinity;
  if (!none && Math.abs(off) <= limits.right_px) return ["right", `Right: ${Math.abs(off).toFixed(2)} px from the truth.`];
  const say = (kind, text) => [kind, `${none ? "No estimate" : `Wrong by ${off > 0 ? "+" : "−"}${Math.abs(off).toFixed(1)} px`}: ${text}.`];
  if (d < low - 0.5 || d > low + count - 0.5) return say("range", `the true disparity ${d.toFixed(1)} is outside the searched range ${low} to ${low + count - 1}`);
  if (truth.hidden && truth.hidden[ty * truth.w + tx]) return say("occluded", "the point is occluded, that is hidden from the right camera or outside its image");
  const windows = [around(left, x, y, radius), around(right, Math.round(x - d), y, radius)];
  const saturated = Math.max(...windows.map((a) => a.filter((v) => v >= left.top * limits.saturated_level).length / a.length));
  if (saturated >= limits.saturated) return say("saturation", `${Math.round(100 * saturated)}% of the window is saturated`);
  const near = [], r = Math.floor(radius / stride);
  for (let v = Math.max(0, ty - r); v <= Math.min(truth.h - 1, ty + r); v++)
    for (let u = Math.max(0, tx - r); u <= Math.min(truth.w - 1, tx + r); u++) if (at(u, v) !== Infinity) near.push(at(u, v));
  const share = (test) => near.filter(test).length / near.length;
  const other = share((value) => Math.abs(value - d) >= limits.jump_px);
  const depths = `discontinuity: ${Math.round(100 * other)}% of the window has another depth`;
  if (!none && share((value) => Math.abs(value - d) >= limits.jump_px && Math.abs(value - est) <= 1) >= limits.other_surface)
    return say("discontinuity", `${depths}, and the estimate is of that surface`);
  const level = Math.sqrt(texture(left, x, y, radius));
  if (level < limits.no_texture) return say("texture", `the window has no texture (RMS difference of neighbours ${level.toFixed(1)} grey levels)`);
  const shifts = none ? [] : [Math.floor(off), Math.ceil(off)].filter((s) => Math.abs(s) >= 2 && x - s >= 0 && x - s < left.w);
  const alike = Math.max(-1, ...shifts.map((s) => correlation(windows[0], around(left, x - s, y, radius))));
  if (alike >= limits.repeated) return say("repetition", `the texture repeats after ${Math.abs(off).toFixed(0)} px (correlation ${alike.toFixed(2)})`);
  if (other >= limits.other_depth) return say("discontinuity", depths);
  const ratio = sharpness(left, x, y, radius) / sharpness(right, Math.round(x - d), y, radius);
  if (Math.max(ratio, 1 / ratio) >= limits.blur) return say("blur", `the ${ratio > 1 ? "right" : "left"} window is more blurred than the ${ratio > 1 ? "left" : "right"} one`);
  if (other >= limits.other_surface) return say("discontinuity", depths);
  const cost = (value) => costs[clamped(Math.round(value) - low, count)].toPrecision(3);
  return say("other", none ? "no known cause" : `no known cause; the cost is ${cost(est)} at the estimate and ${cost(d)} at the truth`);
}

// What may be wrong at a pixel without truth: a kind and a sentence. gap: the left-right difference in pixels, Infinity
// without a match in the right map, null if there is no right map. The rule is that of twinlens.scoring.reasons.
function doubtOf({ x, y, radius, est, low, count, costs, left, gap }) {
  const limits = data.limits, last = low + count - 1, none = est === Infinity;
  const best = lowestOf(costs), rival = rivalOf(costs, best), period = rival - best;
  if (best < 0) return ["unmatched", "No candidate has a match in the right image."];
  const chosen = Math.round(none ? best + low : est), atEnd = chosen <= low || chosen >= last;
  const close = isClose(costs, best, rival), denied = !none && gap != null && !(gap <= data.agree_px);
  if (!none && !atEnd && !close && !denied) return ["none", "No sign of trouble, which is no proof."];
  const say = (kind, text) => [kind, `${none ? "No estimate" : "Doubtful"}: ${text}.`];
  const level = Math.sqrt(texture(left, x, y, radius));
  if (level < limits.no_texture) return say("texture", `the window has no texture (RMS difference of neighbours ${level.toFixed(1)} grey levels)`);
  if (atEnd) return say("range", `the disparity is at an end of the searched range ${low} to ${last}, so the true one may be outside`);
  const alike = close ? correlation(around(left, x, y, radius), around(left, x - period, y, radius)) : -1;
  if (alike >= limits.repeated) return say("repetition", `the texture repeats after ${Math.abs(period)} px (correlation ${alike.toFixed(2)}), where the cost is nearly as low`);
  if (denied && x - Math.round(est) < 0) return say("occluded", "its match is outside the right image");
  if (denied && gap === Infinity) return say("occluded", "the right map has no estimate at its match");
  if (denied) return say("occluded", `the right map differs by ${gap.toFixed(1)} px at its match; the point may be hidden from the right camera`);
  return close ? say("ambiguous", `${Math.abs(period)} px away the cost is nearly as low`) : say("other", "no known cause");
}

// Whether the rival's cost is near the lowest one, on the scale from the lowest to the median cost.
function isClose(costs, best, rival) {
  if (rival < 0) return false;
  const finite = [...costs].filter(Number.isFinite).sort((a, b) => a - b), middle = medianOf(finite);
  return costs[rival] - costs[best] <= data.limits.close * (middle - costs[best]);
}

const medianOf = (sorted) => (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2;

// One method at a pixel: its curve, the estimate, the rival and the reason.
function explain(method, sample, pair, truth, est, gap, x, y) {
  const [left, right] = imagesFor(method.curve, pair), low = sample.low, count = sample.ndisp;
  const costs = costCurve(method.curve, left, right, x, y, low, count);
  const { radius } = method.curve;
  const winner = est === Infinity ? lowestOf(costs) + low : est;
  const rival = rivalOf(costs, Math.round(winner) - low);
  const at = { x, y, radius, est, low, count, costs, left: pair.plain[0], right: pair.plain[1] };
  const [kind, text] = truth ? reasonOf({ ...at, truth }) : doubtOf({ ...at, gap });
  const name = est === Infinity ? "winner" : "estimate"; // refinement may move an estimate from the lowest cost
  return { costs, low, radius, name, winner, rival: rival < 0 ? Infinity : rival + low, kind, text };
}

function curvePlot(found, d) {
  const W = 560, H = 130, left = 8, right = 8, bottom = 20, top = 8, n = found.costs.length;
  const finite = found.costs.filter(Number.isFinite), low = Math.min(...finite), high = Math.max(...finite);
  const px = (value) => left + ((W - left - right) * (value - found.low)) / Math.max(1, n - 1);
  const py = (c) => H - bottom - ((H - bottom - top) * (c - low)) / (high - low || 1);
  const points = [...found.costs].map((c, k) => (Number.isFinite(c) ? `${px(found.low + k).toFixed(1)},${py(c).toFixed(1)}` : "")).filter(Boolean);
  const mark = (value, name) => (Number.isFinite(value) ? el("line", { class: `mark ${name}`, x1: px(value), x2: px(value), y1: top, y2: H - bottom }, el("title", {}, `${name} ${+value.toFixed(2)} px`)) : null);
  const ticks = [0, 0.25, 0.5, 0.75, 1].map((s) => Math.round(found.low + s * (n - 1)));
  return el("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": "cost against disparity" },
    mark(d, "true"), mark(found.winner, found.name), mark(found.rival, "rival"),
    el("polyline", { class: "curve cost", points: points.join(" ") }),
    ticks.map((t, k) => el("text", { x: px(t), y: H - 4, "text-anchor": "middle" }, k === 4 ? `${t} px` : String(t))));
}

// The window around (x - disparity, y), with a margin of its radius, as a picture with a frame around the window.
function windowPicture(img, x, y, radius, disparity, name) {
  if (!Number.isFinite(disparity)) return null;
  const reach = radius + 4, size = 2 * reach + 1, u0 = Math.round(x - disparity) - reach, v0 = y - reach;
  const picture = paint(size, size, (i) => {
    const u = u0 + (i % size), v = v0 + Math.floor(i / size);
    if (u < 0 || v < 0 || u >= img.w || v >= img.h) return noTruth;
    const level = (grey(img, u, v) * 255) / img.top;
    return [level, level, level];
  });
  const inset = `${(100 * 4) / size}%`;
  return el("div", { class: `window ${name}` }, el("div", { class: "crop" }, picture, el("i", { style: `inset:${inset}` })),
    el("span", {}, name === "left" ? "left" : `${name} ${+disparity.toFixed(1)}`));
}

function whyRow(method, found, pair, d, x, y) {
  const [left, right] = pair.plain;
  return el("div", { class: "why-row", "data-kind": found.kind },
    el("div", { class: "why-text" }, el("b", {}, method.name), el("span", { class: "note" }, ` ${method.curve.note}`), el("p", {}, found.text)),
    curvePlot(found, d),
    el("div", { class: "windows" }, windowPicture(left, x, y, found.radius, 0, "left"), windowPicture(right, x, y, found.radius, d, "true"),
      windowPicture(right, x, y, found.radius, found.winner, found.name), windowPicture(right, x, y, found.radius, found.rival, "rival")));
}

let explaining = 0;

// Explain the pixel (x, y) of the selected sample's left image, in full resolution.
async function drawWhy() {
  const mine = ++explaining, sample = sampleNow(), p = sample && sample.pictures, at = state.pixel;
  $("key-truth").hidden = !(p && p.truth);
  const hint = (text) => $("why").replaceChildren(el("p", { class: "empty" }, text));
  if (!p) { $("why").replaceChildren(); return; }
  if (!p.grey) { hint("This page was written without the full-resolution images of this sample, to keep it small."); return; }
  const shown = data.methods.filter((m) => p.maps[m.name]);
  if (!shown.length) { hint("This page was written without the methods' maps of this sample."); return; }
  if (!at) { hint("Click a pixel in an image or a map, or type its column and row."); return; }
  const { w, h, stride } = p;
  const tx = clamped(Math.round(at[0] / stride), w), ty = clamped(Math.round(at[1] / stride), h), i = ty * w + tx;
  const [x, y] = [tx * stride, ty * stride];
  [$("at-u").value, $("at-v").value] = [x, y];
  const pair = await greyOf(p), hidden = p.hidden ? await mapOf(p.hidden) : null;
  const truth = p.truth ? { w, h, stride, values: await mapOf(p.truth), hidden } : null;
  const maps = await Promise.all(shown.map((m) => mapOf(p.maps[m.name])));
  const gaps = await Promise.all(shown.map((m) => (p.differences && p.differences[m.name] ? mapOf(p.differences[m.name]) : null)));
  if (mine !== explaining) return;
  const explained = (m, k) => explain(m, sample, pair, truth, maps[k][i], gaps[k] && gaps[k][i], x, y);
  $("why").replaceChildren(...shown.map((m, k) => whyRow(m, explained(m, k), pair, truth ? truth.values[i] : Infinity, x, y)));
}

function pickPixel(x, y) {
  state.pixel = [x, y];
  return drawWhy();
}
