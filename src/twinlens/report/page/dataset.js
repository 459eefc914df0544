"use strict";
// A dataset: filters by recorded values, thumbnails of those samples that are left, and one sample in a dialog.
// Only the thumbnails in sight are in the document, so that 10,000 samples cost no more than a screenful.

const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const BINS = 24, MOST_TEXTS = 12, CELL = 150, GAP = 12, CAPTION = 24, LOG_ABOVE = 100;

const filters = new Map(); // name of a column -> { test: (value) => boolean, label }
let order = data.names.map((_, i) => i), kept = order.map(() => true), open = -1; // kept: by all filters

function el(tag, properties, ...children) {
  const svg = ["svg", "rect", "title"].includes(tag);
  const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [key, value] of Object.entries(properties || {})) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key.startsWith("--")) made.style.setProperty(key, value);
    else if (value !== false && value != null) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child != null));
  return made;
}

const counted = (n, noun) => `${n.toLocaleString("en")} ${noun}${n === 1 ? "" : "s"}`;
const short = (value) => (value == null ? "–" : typeof value === "string" ? value : String(Number(value.toPrecision(4))));
// Names of samples may hold any character but /, which stays.
const path = (name) => name.split("/").map(encodeURIComponent).join("/");

// ---- columns: constant ones are listed, the others have histograms

for (const column of data.columns) {
  column.present = column.values.filter((value) => value != null);
  column.distinct = new Set(column.values).size;
}
const varied = data.columns.filter((column) => column.distinct > 1);
const constant = data.columns.filter((column) => column.distinct === 1);

function bins(column) {
  const range = column.present.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
  const log = range[0] > 0 && range[1] > LOG_ABOVE * range[0];
  const scale = log ? Math.log : (x) => x, back = log ? Math.exp : (x) => x;
  const [start, end] = range.map(scale);
  const step = (end - start) / BINS || 1;
  const number = (value) => Math.min(BINS - 1, Math.max(0, Math.floor((scale(value) - start) / step)));
  return { number, edge: (i) => (i <= 0 ? range[0] : i >= BINS ? range[1] : back(start + i * step)) };
}

function passes(sample, except) {
  for (const [name, filter] of filters) {
    if (name !== except && !filter.test(byName.get(name).values[sample])) return false;
  }
  return true;
}
const byName = new Map(data.columns.map((column) => [column.name, column]));

function setFilter(name, filter) {
  if (filter) filters.set(name, filter);
  else filters.delete(name);
  refresh();
}

// ---- histograms

function drawHistogram(column) {
  const old = column.box, box = el("div", { class: "histogram" }, el("h3", {}, column.name));
  column.box = box;
  if (column.number) drawNumbers(column, box);
  else drawTexts(column, box);
  if (old) old.replaceWith(box);
  return box;
}

function drawNumbers(column, box) {
  column.bins ||= bins(column);
  const all = new Array(BINS).fill(0), left = new Array(BINS).fill(0);
  column.values.forEach((value, i) => {
    if (value == null) return;
    const bin = column.bins.number(value);
    all[bin] += 1;
    if (kept[i]) left[bin] += 1;
  });
  const top = Math.max(...all), svg = el("svg", { viewBox: `0 0 ${BINS} 10`, preserveAspectRatio: "none", role: "img", "aria-label": `histogram of ${column.name}` });
  const bar = (kind, i, height) => el("rect", { class: kind, x: i + 0.06, width: 0.88, y: 10 - height, height });
  for (let i = 0; i < BINS; i++) {
    // Bars that are not empty can be seen.
    const height = (count) => (count ? Math.max(0.5, (10 * count) / top) : 0);
    svg.append(bar("all", i, height(all[i])), bar("left", i, height(left[i])));
    const text = `${short(column.bins.edge(i))} to ${short(column.bins.edge(i + 1))}: ${counted(all[i], "sample")}`;
    svg.append(el("rect", { class: "hit", x: i, width: 1, y: 0, height: 10 }, el("title", {}, text)));
  }
  dragOver(svg, column);
  box.append(svg, el("div", { class: "ends" }, el("span", {}, short(column.bins.edge(0))), el("span", {}, short(column.bins.edge(BINS)))));
}

// A click on a bar filters by it, a drag by a range, and a click within the range ends the filter.
function dragOver(svg, column) {
  let from = -1;
  const at = (event) => {
    const area = svg.getBoundingClientRect();
    return Math.min(BINS - 1, Math.max(0, Math.floor((BINS * (event.clientX - area.left)) / area.width)));
  };
  svg.addEventListener("pointerdown", (event) => { from = at(event); svg.setPointerCapture(event.pointerId); });
  svg.addEventListener("pointerup", (event) => {
    if (from < 0) return;
    const to = at(event), [a, b] = [Math.min(from, to), Math.max(from, to)], now = filters.get(column.name);
    from = -1;
    if (now && a === b && a >= now.range[0] && a <= now.range[1]) return setFilter(column.name, null);
    const test = (value) => value != null && column.bins.number(value) >= a && column.bins.number(value) <= b;
    setFilter(column.name, { test, range: [a, b], label: `${short(column.bins.edge(a))} to ${short(column.bins.edge(b + 1))}` });
  });
}

function drawTexts(column, box) {
  // Of its own filter, the other values can still be chosen.
  const left = filters.has(column.name) ? data.names.map((_, i) => passes(i, column.name)) : kept;
  const all = new Map();
  column.values.forEach((value, i) => {
    if (value != null && left[i]) all.set(value, (all.get(value) || 0) + 1);
  });
  const sorted = [...all].sort((a, b) => b[1] - a[1]), now = filters.get(column.name);
  for (const [value, count] of sorted.slice(0, MOST_TEXTS)) {
    const on = Boolean(now && now.label === String(value));
    const filter = { test: (other) => other === value, label: String(value) };
    box.append(el("button", {
      type: "button", class: "bar", "aria-pressed": String(on), "--share": `${(100 * count) / sorted[0][1]}%`,
      onclick: () => setFilter(column.name, on ? null : filter),
    }, el("span", {}, String(value)), el("span", {}, count.toLocaleString("en"))));
  }
  const others = sorted.length - MOST_TEXTS;
  if (others > 0) box.append(el("p", { class: "note" }, `and ${counted(others, "other value")}`));
}

// ---- the grid of thumbnails

const cells = new Map();

function layout() {
  const width = $("grid").clientWidth, columns = Math.max(2, Math.floor((width + GAP) / (CELL + GAP)));
  const size = (width - GAP * (columns - 1)) / columns;
  return { columns, size, row: size * 0.75 + CAPTION + GAP };
}

function drawGrid() {
  const { columns, size, row } = layout(), grid = $("grid");
  grid.style.height = `${Math.ceil(order.length / columns) * row}px`;
  const top = grid.getBoundingClientRect().top;
  const first = Math.max(0, Math.floor(-top / row) - 1) * columns;
  const last = Math.min(order.length, (Math.ceil((innerHeight - top) / row) + 1) * columns);
  const wanted = new Set();
  for (let place = first; place < last; place++) {
    const sample = order[place], cell = cells.get(sample) || makeCell(sample);
    wanted.add(sample);
    cell.style.width = `${size}px`;
    cell.style.transform = `translate(${(place % columns) * (size + GAP)}px, ${Math.floor(place / columns) * row}px)`;
    cell.lastChild.textContent = caption(sample);
  }
  for (const [sample, cell] of cells) {
    if (!wanted.has(sample)) { cell.remove(); cells.delete(sample); }
  }
}

function caption(sample) {
  const by = byName.get($("sort").value);
  return by ? `${short(by.values[sample])} · ${data.names[sample]}` : data.names[sample];
}

function makeCell(sample) {
  const name = data.names[sample], source = `thumbnails/${path(name)}.webp`;
  const cell = el("button", { type: "button", class: "cell", title: name, onclick: () => show(sample) },
    el("img", { src: source, alt: "", decoding: "async" }), el("span", {}));
  cells.set(sample, cell);
  $("grid").append(cell);
  return cell;
}

function arrange() {
  const by = byName.get($("sort").value), sign = Number($("turn").value);
  kept = data.names.map((_, i) => passes(i));
  order = data.names.map((_, i) => i).filter((i) => kept[i]);
  const compare = (a, b) => (a < b ? -1 : a > b ? 1 : 0);
  if (by) {
    // Samples without the value come last.
    order.sort((i, j) => {
      const [a, b] = [by.values[i], by.values[j]];
      return a == null || b == null ? (a == null) - (b == null) : sign * compare(a, b);
    });
  } else if (sign < 0) order.reverse();
}

function refresh() {
  arrange();
  const all = data.names.length;
  $("count").textContent = order.length === all ? counted(all, "sample") : `${order.length.toLocaleString("en")} of ${counted(all, "sample")}`;
  $("filters").replaceChildren(...[...filters].map(([name, filter]) => el("span", { class: "chip" }, el("span", {}, name), filter.label,
    el("button", { type: "button", "aria-label": `Remove the filter of ${name}`, onclick: () => setFilter(name, null) }, "✕"))));
  if ($("values").open) for (const column of varied) drawHistogram(column);
  drawGrid();
}

// ---- one sample

function show(sample) {
  open = sample;
  const name = data.names[sample], kinds = data.tiles.kinds[data.tiles.of[sample]] || [];
  $("sample-title").textContent = name;
  $("tiles").replaceChildren(...kinds.map(([title, file], i) => tile(sample, title, file, i, kinds.length)));
  if (data.problems[name]) $("tiles").append(el("p", {}, data.problems[name]));
  const values = data.columns.filter((column) => column.values[sample] != null);
  $("sample-values").replaceChildren(...values.flatMap((column) => [el("dt", {}, column.name), el("dd", {}, short(column.values[sample]))]));
  const place = order.indexOf(sample);
  $("previous").disabled = place <= 0;
  $("next").disabled = place < 0 || place === order.length - 1;
  if (!$("sample").open) $("sample").showModal();
  $("sample").scrollTop = 0;
}

function tile(sample, title, file, number, count) {
  const name = data.names[sample], span = data.tiles.spans[sample][number];
  const picture = el("button", { type: "button", class: "picture", "aria-label": `Enlarge ${title}` });
  picture.style.backgroundImage = `url("channels/${path(name)}.webp")`;
  picture.style.backgroundSize = `${100 * count}% 100%`;
  picture.style.backgroundPosition = `${count > 1 ? (100 * number) / (count - 1) : 0}% 0`;
  picture.style.aspectRatio = ratio(sample);
  const place = data.root && file ? `${path(data.root)}/${path(name)}/${path(file)}` : "";
  const link = place ? el("a", { href: place, target: "_blank", rel: "noopener" }, "open") : null;
  const figure = el("figure", {}, picture, el("figcaption", {}, title, span ? el("small", {}, span) : null, link));
  picture.addEventListener("click", () => figure.classList.toggle("wide"));
  return figure;
}

// The shape of the images, of which all tiles of a sample have.
function ratio(sample) {
  const [width, height] = ["width", "height"].map((name) => (byName.get(name) ? byName.get(name).values[sample] : null));
  return width && height ? `${width} / ${height}` : "4 / 3";
}

function step(by) {
  const next = order[order.indexOf(open) + by];
  if (next != null) show(next);
}

// ---- start

function start() {
  const { description, licence, creator } = data.about, parts = [description, creator && `Made by ${creator}.`, licence && `Licence: ${licence}.`];
  $("summary").textContent = parts.filter(Boolean).join(" ");
  const broken = Object.entries(data.problems);
  if (broken.length) {
    const lines = broken.slice(0, 5).map(([name, text]) => el("p", {}, `${name}: ${text}`));
    $("problems").append(el("p", {}, `${counted(broken.length, "sample")} cannot be shown:`), ...lines);
  }
  $("sort").append(el("option", { value: "" }, "name"), ...varied.map((column) => el("option", {}, column.name)));
  $("constants").append(...constant.flatMap((column) => [el("dt", {}, column.name), el("dd", {}, short(column.values[0]))]));
  $("values").open = innerWidth > 820;
  $("histograms").append(...varied.map(drawHistogram));
  $("values").addEventListener("toggle", refresh);
  $("find").addEventListener("input", () => {
    const text = $("find").value.trim().toLowerCase();
    for (const column of varied) column.box.hidden = !column.name.toLowerCase().includes(text);
  });
  $("sort").addEventListener("change", refresh);
  $("turn").addEventListener("change", refresh);
  $("previous").addEventListener("click", () => step(-1));
  $("next").addEventListener("click", () => step(1));
  $("close").addEventListener("click", () => $("sample").close());
  $("sample").addEventListener("click", (event) => { if (event.target === $("sample")) $("sample").close(); });
  addEventListener("keydown", (event) => {
    if ($("sample").open && event.key === "ArrowLeft") step(-1);
    if ($("sample").open && event.key === "ArrowRight") step(1);
  });
  $("theme").addEventListener("click", () => {
    const root = document.documentElement;
    root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
  });
  if (matchMedia("(prefers-color-scheme: dark)").matches) document.documentElement.dataset.theme = "dark";
  addEventListener("scroll", drawGrid, { passive: true });
  addEventListener("resize", drawGrid);
  refresh();
  const named = data.names.indexOf(decodeURIComponent(location.hash.slice(1)));
  if (named >= 0) show(named);
  document.documentElement.dataset.ready = "yes";
}

start();
