// Matching costs of one pixel, by the formulas of twinlens.matching.measures, from full-resolution grey images.

// A grey image {w, h, values}; pixels outside repeat the nearest edge pixel.
const clamped = (i, n) => Math.max(0, Math.min(n - 1, i));
const grey = (img, x, y) => img.values[clamped(y, img.h) * img.w + clamped(x, img.w)];

async function unpackGrey(packed) {
  const values = Float64Array.from(await mapOf(packed), (v) => (v === Infinity ? 65535 : v)); // the code of no disparity
  return { w: packed.w, h: packed.h, values, top: packed.top };
}

// The prefilter xsobel: horizontal Sobel derivative of levels 0..255, clipped to 31, plus 31.
function clippedSlope(img) {
  const level = (x, y) => Math.round((grey(img, x, y) * 255) / img.top);
  const values = Float64Array.from(img.values, (_, i) => {
    const x = i % img.w, y = (i - x) / img.w;
    const down = (u) => level(u, y - 1) + 2 * level(u, y) + level(u, y + 1);
    return Math.max(-31, Math.min(31, down(x + 1) - down(x - 1))) + 31;
  });
  return { ...img, values };
}

// What is compared at a pixel inside the image: a number, census bits, or (value, lowest, highest within half a pixel).
const describe = {
  census(img, x, y, side) {
    const r = side >> 1, bits = new Uint8Array(side * side), centre = grey(img, x, y);
    for (let v = -r, k = 0; v <= r; v++) for (let u = -r; u <= r; u++, k++) bits[k] = grey(img, x + u, y + v) < centre ? 1 : 0;
    return bits;
  },
  rank: (img, x, y, side) => describe.census(img, x, y, side).reduce((a, b) => a + b, 0),
  birchfield_tomasi(img, x, y) {
    const a = grey(img, x, y), near = [a, (grey(img, x - 1, y) + a) / 2, (a + grey(img, x + 1, y)) / 2];
    return [a, Math.min(...near), Math.max(...near)];
  },
};

const sum = (a, b, term) => { let s = 0; for (let i = 0; i < a.length; i++) s += term(a[i], b[i]); return s; };
const centred = (a) => { const mean = sum(a, a, (v) => v) / a.length; return a.map((v) => v - mean); };
const flat = (a) => a.every((v) => v === a[0]);

function cosine(a, b) {
  const norm = Math.sqrt(sum(a, a, (v, w) => v * w)) * Math.sqrt(sum(b, b, (v, w) => v * w));
  return norm > 0 ? sum(a, b, (v, w) => v * w) / norm : 0;
}

const correlation = (a, b) => (flat(a) || flat(b) ? 0 : cosine(centred(a), centred(b)));

// Costs of two windows, arrays of one length; lower is better, 1 - similarity for similarities.
const measures = {
  sad: (a, b) => sum(a, b, (v, w) => Math.abs(v - w)),
  ssd: (a, b) => sum(a, b, (v, w) => (v - w) ** 2),
  zsad: (a, b) => measures.sad(centred(a), centred(b)),
  zssd: (a, b) => measures.ssd(centred(a), centred(b)),
  ncc: (a, b) => 1 - cosine(a, b),
  zncc: (a, b) => 1 - correlation(a, b),
  jaccard(a, b) {
    const union = sum(a, b, Math.max);
    return union > 0 ? 1 - sum(a, b, Math.min) / union : 0;
  },
  census: (a, b) => sum(a, b, (v, w) => sum(v, w, (p, q) => p ^ q)),
  rank: (a, b) => measures.sad(a, b),
  birchfield_tomasi: (a, b) => sum(a, b, (v, w) => Math.max(0, Math.min(Math.max(v[0] - w[2], w[1] - v[0]), Math.max(w[0] - v[2], v[1] - w[0])))),
};

// The descriptions, or grey values, of the window around (x, y), row by row; `known` caches descriptions by pixel.
function windowOf(img, x, y, method, known) {
  const r = method.block_size >> 1, out = [], compute = describe[method.cost];
  for (let v = y - r; v <= y + r; v++) for (let u = x - r; u <= x + r; u++) {
    if (!compute) { out.push(grey(img, u, v)); continue; }
    const i = clamped(v, img.h) * img.w + clamped(u, img.w);
    if (!known.has(i)) known.set(i, compute(img, i % img.w, Math.floor(i / img.w), method.census_window));
    out.push(known.get(i));
  }
  return out;
}

// The cost of each disparity low, low + 1, ..., Infinity where u - d is outside the right image.
function costCurve(method, left, right, x, y, low, count) {
  const here = windowOf(left, x, y, method, new Map()), known = new Map();
  return Float64Array.from({ length: count }, (_, k) => {
    const u = x - low - k;
    return u < 0 || u >= right.w ? Infinity : measures[method.cost](here, windowOf(right, u, y, method, known));
  });
}

// The place of the lowest cost, and that of the lowest local minimum two or more away from `from`; -1 if there is none.
const lowestOf = (costs) => costs.reduce((best, c, k) => (c < (best < 0 ? Infinity : costs[best]) ? k : best), -1);

function rivalOf(costs, from) {
  const at = (k) => (k < 0 || k >= costs.length ? Infinity : costs[k]);
  const minimum = costs.map((c, k) => (Math.abs(k - from) >= 2 && c <= at(k - 1) && c <= at(k + 1) ? c : Infinity));
  return lowestOf(minimum);
}
