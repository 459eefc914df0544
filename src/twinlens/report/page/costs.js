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
  return { ...img, values, top: 255 };
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

// The descriptions, or grey values, of the window of this side around (x, y), row by row; `known` caches descriptions.
function windowOf(img, x, y, side, cost, censusWindow, known) {
  const r = side >> 1, out = [], compute = describe[cost];
  for (let v = y - r; v <= y + r; v++) for (let u = x - r; u <= x + r; u++) {
    if (!compute) { out.push(grey(img, u, v)); continue; }
    const i = clamped(v, img.h) * img.w + clamped(u, img.w);
    if (!known.has(i)) known.set(i, compute(img, i % img.w, Math.floor(i / img.w), censusWindow));
    out.push(known.get(i));
  }
  return out;
}

// A function of (x, y) that keeps its results.
function kept(compute) {
  const known = new Map();
  return (x, y) => {
    const key = `${x},${y}`;
    if (!known.has(key)) known.set(key, compute(x, y));
    return known.get(key);
  };
}

// The search of one method in one pair, disparities low, low + 1, ...: what the supports below read.
function searchOf(method, left, right, low, count) {
  const known = [new Map(), new Map()], level = (img) => (x, y) => Math.round((grey(img, x, y) * 255) / img.top);
  const windows = (side) => kept((x, y) => {
    const here = windowOf(left, x, y, side, method.cost, method.census_window, known[0]);
    return Float64Array.from({ length: count }, (_, k) => measures[method.cost](here, windowOf(right, x - low - k, y, side, method.cost, method.census_window, known[1])));
  });
  return { method, w: left.w, h: left.h, low, count, side: method.block_size, windows, left: level(left), right: level(right) };
}

// Of costs at x: Infinity where u - d is outside the right image.
const masked = (s, x, costs) => costs.map((c, k) => (x - s.low - k < 0 || x - s.low - k >= s.w ? Infinity : c));

// All pixels (u, v) of the image within r of (x, y).
function* inside(s, x, y, r) {
  for (let v = Math.max(0, y - r); v <= Math.min(s.h - 1, y + r); v++)
    for (let u = Math.max(0, x - r); u <= Math.min(s.w - 1, x + r); u++) yield [u, v];
}

const zeros = (s) => new Float64Array(s.count);
const odd = (value) => 2 * Math.floor(value / 2) + 1;
const quarter = (side) => 2 * (side >> 2) + 1;

// The supports of twinlens.matching.supports: each returns the aggregated costs as a function of (x, y).
const supports = {
  fixed: (s) => s.windows(s.side),

  shiftable(s) {
    const at = s.windows(s.side);
    return (x, y) => {
      const out = zeros(s).fill(Infinity);
      for (const [u, v] of inside(s, x, y, s.side >> 1)) masked(s, u, at(u, v)).forEach((c, k) => { out[k] = Math.min(out[k], c); });
      return out;
    };
  },

  adaptive(s) {
    const least = Math.min(s.side, 5), sides = [1, 0.75, 0.5].map((part) => Math.max(odd(Math.trunc(part * s.side)), least));
    const at = sides.map((side) => s.windows(quarter(side)));
    const slope = (u, v) => {
      const a = Math.max(u - 1, 0), b = Math.min(u + 1, s.w - 1);
      return b > a ? (s.left(b, v) - s.left(a, v)) / (b - a) : 0;
    };
    const sums = !["ncc", "zncc", "jaccard"].includes(s.method.cost), needed = (2 * s.method.noise ** 2) / 0.05 ** 2;
    return (x, y) => {
      let best = 0;
      sides.forEach((side, k) => {
        let energy = 0;
        const r = side >> 1;
        for (let v = y - r; v <= y + r; v++) for (let u = x - r; u <= x + r; u++) energy += slope(clamped(u, s.w), clamped(v, s.h)) ** 2;
        if (Math.round(4 * energy) >= 4 * needed) best = k;
      });
      const side = sides[best], step = (side >> 1) - (quarter(side) >> 1), cost = at[best];
      const [up, down, first, last] = [clamped(y - step, s.h), clamped(y + step, s.h), clamped(x - step, s.w), clamped(x + step, s.w)];
      const four = [cost(first, up), cost(last, up), cost(first, down), cost(last, down)];
      const scale = sums ? (quarter(sides[0]) / quarter(side)) ** 2 : 1;
      return cost(x, y).map((c, k) => {
        const near = four.map((costs) => costs[k]).sort((a, b) => a - b);
        return scale * (c + near[0] + near[1]);
      });
    };
  },

  cross(s) {
    const at = s.windows(1), limit = Math.min(Math.trunc(s.method.contrast), 255), length = s.side >> 1;
    const arm = (x, y, dx, dy) => {
      let n = 0;
      while (n < length) {
        const u = x + dx * (n + 1), v = y + dy * (n + 1);
        if (u < 0 || v < 0 || u >= s.w || v >= s.h || Math.abs(s.left(x, y) - s.left(u, v)) > limit) break;
        n++;
      }
      return n;
    };
    return (x, y) => {
      const out = zeros(s);
      let size = 0;
      for (let v = y - arm(x, y, 0, -1); v <= y + arm(x, y, 0, 1); v++)
        for (let u = x - arm(x, v, -1, 0); u <= x + arm(x, v, 1, 0); u++, size++) at(u, v).forEach((c, k) => { out[k] += c; });
      return out.map((c) => c / size);
    };
  },

  weighted(s) {
    const at = s.windows(1), { gamma_near: near, gamma_similar: similar } = s.method;
    const alike = (a, b) => Math.exp(-Math.abs(a - b) / similar);
    return (x, y) => {
      const out = zeros(s), norm = zeros(s);
      for (const [u, v] of inside(s, x, y, s.side >> 1)) {
        const here = Math.exp((-2 * Math.hypot(u - x, v - y)) / near) * alike(s.left(x, y), s.left(u, v));
        at(u, v).forEach((c, k) => {
          const d = s.low + k, weight = here * alike(s.right(x - d, y), s.right(u - d, v));
          out[k] += weight * c;
          norm[k] += weight;
        });
      }
      return out.map((c, k) => c / norm[k]);
    };
  },

  guided(s) {
    const at = s.windows(1), r = s.side >> 1, guide = (u, v) => s.left(u, v) / 255;
    const line = kept((x, y) => { // slope and intercept of the window around (x, y), for each candidate
      let n = 0, mean = 0, square = 0;
      const cost = zeros(s), product = zeros(s);
      for (const [u, v] of inside(s, x, y, r)) {
        const g = guide(u, v);
        n++; mean += g; square += g * g;
        at(u, v).forEach((c, k) => { cost[k] += c; product[k] += c * g; });
      }
      mean /= n;
      const bottom = Math.max(square / n - mean * mean, 0) + s.method.epsilon;
      const slope = product.map((p, k) => (p / n - (mean * cost[k]) / n) / bottom);
      return [slope, slope.map((a, k) => cost[k] / n - a * mean)];
    });
    return (x, y) => {
      const out = zeros(s), g = guide(x, y);
      let n = 0;
      for (const [u, v] of inside(s, x, y, r)) {
        const [slope, intercept] = line(u, v);
        out.forEach((_, k) => { out[k] += slope[k] * g + intercept[k]; });
        n++;
      }
      return out.map((c) => c / n);
    };
  },
};

// The largest possible cost: the unit of p1 and p2.
function largestCost({ cost, census_window: window }, side, top) {
  if (["ncc", "zncc", "jaccard"].includes(cost)) return cost === "zncc" ? 2 : 1;
  if (["census", "rank"].includes(cost)) return (window ** 2 - 1) * side ** 2;
  return side ** 2 * (["ssd", "zssd"].includes(cost) ? top ** 2 : top);
}

// Semi-global costs of (x, y): the mean over the paths' costs, each followed from where its ray enters the image.
function semiGlobal(s, x, y, at, top) {
  const adaptive = s.method.support === "adaptive", side = adaptive ? quarter(s.side) : s.method.pixelwise ? 1 : s.side;
  const full = largestCost(s.method, side, top) * (adaptive ? 3 : 1), { p1, p2 } = s.method;
  const most = Math.trunc(8191 / (1 + p2)) - 1;
  const whole = s.method.support === "fixed" && ["sad", "ssd", "census", "rank"].includes(s.method.cost) && full <= most;
  const inBoxes = s.method.support === "fixed" && s.method.cost !== "zsad"; // the kernels round these halves up
  const rounded = inBoxes ? Math.round : (c) => (c % 1 === 0.5 ? 2 * Math.round(c / 2) : Math.round(c));
  const [gain, peak] = whole ? [1, Math.trunc(full)] : [most / full, most];
  const small = Math.round(p1 * peak), large = Math.round(p2 * peak), total = zeros(s);
  const rays = [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]].slice(0, s.method.paths);
  for (const [dx, dy] of rays) {
    let steps = 0;
    while (x - dx * (steps + 1) >= 0 && x - dx * (steps + 1) < s.w && y - dy * (steps + 1) >= 0 && y - dy * (steps + 1) < s.h) steps++;
    let path = null;
    for (let n = steps; n >= 0; n--) {
      const u = x - dx * n, costs = masked(s, u, at(u, y - dy * n)).map((c) => Math.min(rounded(Math.max(c, 0) * gain), peak));
      const before = path, least = before ? before.reduce((a, b) => Math.min(a, b)) : 0;
      path = !before ? costs : costs.map((c, k) => {
        const beside = Math.min(k > 0 ? before[k - 1] : Infinity, k + 1 < before.length ? before[k + 1] : Infinity) + small;
        return c + Math.min(before[k], beside, least + large) - least;
      });
    }
    path.forEach((c, k) => { total[k] += c; });
  }
  return total.map((c) => c / (gain * rays.length));
}

// The cost of each disparity low, low + 1, ..., as the method minimises it; Infinity where u - d is outside the image.
function costCurve(method, left, right, x, y, low, count) {
  const s = searchOf(method, left, right, low, count), at = supports[method.support](s);
  return masked(s, x, method.paths ? semiGlobal(s, x, y, at, left.top) : at(x, y));
}

// The place of the lowest cost, and that of the lowest local minimum two or more away from `from`; -1 if there is none.
const lowestOf = (costs) => costs.reduce((best, c, k) => (c < (best < 0 ? Infinity : costs[best]) ? k : best), -1);

function rivalOf(costs, from) {
  const at = (k) => (k < 0 || k >= costs.length ? Infinity : costs[k]);
  const minimum = costs.map((c, k) => (Math.abs(k - from) >= 2 && c <= at(k - 1) && c <= at(k + 1) ? c : Infinity));
  return lowestOf(minimum);
}
