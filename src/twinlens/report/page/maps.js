// Unpacks and colours maps of numbers, and draws their legends.

const luts = Object.fromEntries(Object.entries(data.colormaps).map(([name, text]) => [name, Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]));
const unpacked = new Map();

// Row differences of 16-bit codes, low bytes before high bytes, deflated; see packing.py.
async function unpack(packed) {
  const planes = new Uint8Array(await inflate(packed.data));
  const size = packed.w * packed.h, values = new Float32Array(size);
  for (let i = 0, code = 0; i < size; i++) {
    if (i % packed.w === 0) code = 0;
    code = (code + planes[i] + 256 * planes[size + i]) & 65535;
    values[i] = code === 65535 ? Infinity : packed.offset + code * packed.step;
  }
  return values;
}

function mapOf(packed) {
  if (!unpacked.has(packed)) unpacked.set(packed, unpack(packed));
  return unpacked.get(packed);
}

// colour(i) -> [value, low, high, lut], or [r, g, b].
function paint(width, height, colour) {
  const canvas = el("canvas", { width, height }), context = canvas.getContext("2d"), image = context.createImageData(width, height);
  for (let i = 0; i < width * height; i++) {
    const c = colour(i);
    let r = c[0], g = c[1], b = c[2];
    if (c.length === 4) {
      const k = 3 * Math.max(0, Math.min(255, Math.round((255 * (c[0] - c[1])) / (c[2] - c[1]))));
      r = c[3][k]; g = c[3][k + 1]; b = c[3][k + 2];
    }
    image.data.set([r, g, b, 255], 4 * i);
  }
  context.putImageData(image, 0, 0);
  return canvas;
}

const noTruth = data.unknown.truth, noEstimate = data.unknown.estimate;
const css = (rgb) => `rgb(${rgb.join(" ")})`;

const painters = {
  disparity: (values, range, flat) => (i) => (values[i] === Infinity ? flat : [values[i], range[0], range[1], luts.viridis]),
  size: (est, truth, limit) => (i) => (truth[i] === Infinity ? noTruth : est[i] === Infinity ? noEstimate : [Math.abs(est[i] - truth[i]), 0, limit, luts.magma]),
  signed: (est, truth, limit) => (i) => (truth[i] === Infinity ? noTruth : est[i] === Infinity ? noEstimate : [est[i] - truth[i], -limit, limit, luts.berlin]),
  closer: (a, b, truth, limit) => (i) => (truth[i] === Infinity ? noTruth : a[i] === Infinity || b[i] === Infinity ? noEstimate
    : [Math.abs(a[i] - truth[i]) - Math.abs(b[i] - truth[i]), -limit, limit, luts.berlin]),
};

// Without truth: the difference from the right map, and the residual, are unknown without a match in the right image.
const checks = {
  difference: (est, gap, limit) => (i) => (est[i] === Infinity ? noEstimate : gap[i] === Infinity ? noTruth : [gap[i], 0, limit, luts.magma]),
  disagreement: (shares) => (i) => (shares[i] === Infinity ? noEstimate : [shares[i], 0, 100, luts.magma]),
  apart: (a, b, limit) => (i) => (a[i] === Infinity || b[i] === Infinity ? noEstimate : [a[i] - b[i], -limit, limit, luts.berlin]),
};

// For each pixel the percentage of the pairs of maps with an estimate there that are apart; Infinity without a pair.
function disagreementOf(maps) {
  return Float32Array.from({ length: maps[0].length }, (_, i) => {
    let pairs = 0, apart = 0;
    for (let a = 0; a < maps.length; a++) for (let b = 0; b < a; b++) {
      if (maps[a][i] === Infinity || maps[b][i] === Infinity) continue;
      pairs += 1;
      apart += Math.abs(maps[a][i] - maps[b][i]) > data.agree_px ? 1 : 0;
    }
    return pairs ? (100 * apart) / pairs : Infinity;
  });
}

function legend(lut, low, high, keys) {
  const bar = paint(128, 1, (i) => [i, 0, 127, luts[lut]]);
  const key = { truth: [css(noTruth), "no truth"], estimate: [css(noEstimate), "no estimate"], match: [css(noTruth), "no match"], pair: [css(noEstimate), "fewer than two estimates"] };
  return el("div", { class: "legend" }, el("span", {}, low), bar, el("span", {}, high),
    keys.map((k) => el("span", { class: "key" }, el("i", { style: `background:${key[k][0]}` }), key[k][1])));
}

function panel(title, detail, picture, below) {
  const widen = (event) => {
    const figure = event.currentTarget.closest("figure");
    state.wide = state.wide === title ? "" : title;
    for (const other of figure.parentElement.children) other.classList.toggle("wide", other === figure && state.wide === title);
  };
  return el("figure", { class: state.wide === title ? "card panel wide" : "card panel" },
    el("figcaption", {}, el("span", { title }, title), el("span", {}, detail),
      el("button", { type: "button", class: "ghost enlarge", title: "enlarge or shrink", "aria-label": `${title}: enlarge or shrink`, onclick: widen }, "⤢")),
    el("div", { class: "view" }, picture, el("div", { class: "cross" })), below);
}
