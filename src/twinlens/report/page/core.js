"use strict";
// Shared by all parts: the data, the state of the controls, and elements built from text, never from markup.

const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const byName = (list, name) => list.find((item) => item.name === name);

const state = {
  protocol: data.protocols.length ? data.protocols[0].name : "",
  region: data.protocols.length ? usualRegion(data.protocols[0]) : "",
  over: "", by: data.by, sort: "", flipped: false, columns: "main",
  sample: "", method: "", first: "", second: "", range: 4, wide: "", pixel: null,
};

// The region that is shown first; "" on a board where nothing was scored.
function usualRegion(protocol) {
  const names = protocol.regions.length ? protocol.regions : data.regions.map((r) => r.name);
  return names.includes("nonocc") ? "nonocc" : names[0] || "";
}

// The samples with entries of a protocol: one that needs truth has none of a sample without truth.
const samplesOf = (protocol) => data.samples.filter((s) => protocol.samples.includes(s.name));

function selectProtocol(name) {
  state.protocol = name;
  state.sort = "";
  const { regions, samples } = rules();
  if (!regions.includes(state.region)) state.region = usualRegion(rules());
  if (overSample() && !samples.includes(state.over)) state.over = "";
  if (samples.includes(state.sample)) return;
  state.pixel = null;
  state.sample = (samplesOf(rules()).find((s) => s.pictures) || { name: samples[0] }).name;
}

// A sample is shown with the scores of a protocol that it has.
function selectSample(name) {
  if (name !== state.sample) state.pixel = null;
  state.sample = name;
  if (!rules().samples.includes(name)) selectProtocol(data.protocols.find((p) => p.samples.includes(name)).name);
}

function el(tag, properties, ...children) {
  const made = tag === "svg" || el.svg.has(tag) ? document.createElementNS("http://www.w3.org/2000/svg", tag)
    : document.createElement(tag);
  for (const [key, value] of Object.entries(properties || {})) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key.startsWith("--")) made.style.setProperty(key, value);
    else if (value !== false && value != null) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child != null));
  return made;
}
el.svg = new Set(["circle", "line", "polyline", "text", "g", "title"]);

// A method's name, which may break after the punctuation of its options.
const breakable = (name) => name.split(/(?<=[:,=_])/).flatMap((part, i) => (i ? [el("wbr"), part] : [part]));

// A number with its noun; its verb. As `errors.counted`.
const counted = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;
const have = (n) => (n === 1 ? "has" : "have");

const number = (value) => (value == null ? NaN : value === "inf" ? Infinity : value);

function show(metric, value) {
  if (Number.isNaN(value)) return "–";
  if (value === Infinity) return "∞";
  if (["%", "px", "grey"].includes(data.metrics[metric].unit)) return value.toFixed(2);
  return value === 0 ? "0" : value >= 1000 ? Math.round(value).toString() : value.toPrecision(3);
}

// A difference of two values with as many decimals as the values have.
function showGap(metric, a, b) {
  const gap = b - a;
  if (!Number.isFinite(gap)) return "–";
  const decimals = (value) => (show(metric, value).split(".")[1] || "").length;
  const text = Math.abs(gap).toFixed(Math.min(decimals(a), decimals(b)));
  return Number(text) ? `${gap > 0 ? "+" : "−"}${text}` : text;
}

// Best first, or worst first if flipped; NaN last in both cases.
function compareBy(metric, flipped) {
  const sign = (data.metrics[metric].lower ? 1 : -1) * (flipped ? -1 : 1);
  return (a, b) => (Number.isNaN(a) ? 1 : 0) - (Number.isNaN(b) ? 1 : 0) || (a === b ? 0 : sign * (a - b)) || 0;
}

const keyOf = (method, sample, protocol) => JSON.stringify([method, sample, protocol]);
const entries = new Map(data.entries.map((e) => [keyOf(e.method, e.sample, e.protocol), e]));
const entryOf = (method, sample) => entries.get(keyOf(method, sample, state.protocol));
const places = Object.fromEntries(data.protocols.map((p) => [p.name, Object.fromEntries(p.metrics.map((m, i) => [m, i]))]));

// A group of samples, and the sample, that the "Over" control selects, if any.
const groups = data.groupings.flatMap((grouping) => grouping.groups.map((g) => ({ ...g, by: grouping.by, key: `${grouping.by || "mean"}: ${g.name}` })));
const groupOf = (over) => groups.find((g) => over === g.key);
// Groups without a recorded value take the place of the mean over all samples.
const titled = groups.filter((g) => !g.by);
if (titled.length) state.over = titled[0].key;
const overSample = () => (byName(data.samples, state.over) ? state.over : "");

// A method's numbers for the selected protocol and region: the mean over all samples or a group, or one sample's.
function scoresOf(method, over) {
  const empty = { value: () => NaN, n: 0, failed: [], missing: [], failure: null };
  const group = groupOf(over);
  if (!over || group) {
    const mean = (group || data).means[state.protocol][state.region][method];
    return { value: (metric) => number(mean.v[metric]), n: mean.n, failed: mean.failed, missing: mean.missing, failure: null };
  }
  const entry = entryOf(method, over);
  if (!entry) return empty;
  const region = entry.regions[state.region];
  const value = (metric) => number(data.times.includes(metric) ? entry.times[metric] : region && region.v[places[state.protocol][metric]]);
  return { ...empty, value, n: region ? region.n[1] : 0, failure: entry.failure, counts: region && region.n };
}

// Keyboard equivalent of a click: Enter or space, as on a button.
const pressed = (act) => (event) => {
  if (event.key !== "Enter" && event.key !== " ") return;
  event.preventDefault();
  act(event);
};

function ordinal(n) {
  const teen = n % 100 > 10 && n % 100 < 14;
  return `${n}${(!teen && ["", "st", "nd", "rd"][n % 10]) || "th"}`;
}

function options(select, names, chosen, texts) {
  select.replaceChildren(...names.map((name, i) => el("option", { value: name, selected: name === chosen }, texts ? texts[i] : name)));
}

function segments(box, items, chosen, pick) {
  box.replaceChildren(...items.map(([value, text]) =>
    el("button", { type: "button", "aria-pressed": String(value === chosen), onclick: () => pick(value) }, text)));
}

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

async function save(name, type, packed) {
  const text = await inflate(packed);
  const link = el("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  try { localStorage.setItem("twinlens-theme", name); } catch { /* pages from file:// may have no storage */ }
}

function firstTheme() {
  const requested = /theme=(light|dark)/.exec(location.hash);
  if (requested) return requested[1];
  try { if (localStorage.getItem("twinlens-theme")) return localStorage.getItem("twinlens-theme"); } catch { /* see above */ }
  return matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
}
