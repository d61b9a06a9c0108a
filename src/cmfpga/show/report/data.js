/* First of the three parts of the report's script: all numbers come from the data in the page; images of warped events
   and contrasts are computed here from the batch's events, by the equations of cmfpga.imaging.iwe. */

const { columns, details, roi, sensor } = head;
const batches = columns.batch.length;
const missing = "—";
let level = 0, pair = [0, 1]; // of the landscape: its pixels, and the parameters that it is drawn over

function unpack(raw) {
  const total = details.reduce((sum, detail) => sum + detail.events, 0);
  const [, width, height] = head.frame, [bits, half] = head.place;
  let event = 0;
  details.forEach((detail, k) => {
    const n = detail.events;
    detail.since = Float64Array.from(new Uint32Array(raw, 4 * event, n));
    for (let i = 1; i < n; ++i) detail.since[i] += detail.since[i - 1];
    [detail.x, detail.y] = [4, 6].map((bytes) =>
      Float64Array.from(new Uint16Array(raw, bytes * total + 2 * event, n), (value) => value / 2 ** bits - half));
    detail.frame = new Uint8Array(raw, 8 * total + k * width * height, width * height);
    event += n;
  });
}

/* Scaled times dt, −1 … 1. */
function scaledTimes(detail) {
  const span = head.spans[detail.batch];
  return detail.since.map((since) => (2 * since - span) / span);
}

/* Positions as the ascent uses them: each event a fraction of a pixel off, if the configuration has a dither. */
function dithered(values, axis) {
  const { frac, bits, factors } = head.dither;
  if (!frac) return Float64Array.from(values);
  const whole = 2 ** bits, factor = factors[axis], half = Math.floor(factor / 2);
  return Float64Array.from(values, (value, k) =>
    value + Math.floor(((half + k * factor) % whole) / 2 ** (bits - frac)) / 2 ** frac - 0.5);
}

/* Of each parameter of the motion: how far it moves the events along x and y, per unit. */
function basisOf(detail) {
  const { parameters, lever, middle, square } = head.motion;
  const corner = [columns.roi_x, columns.roi_y].map((column) => Number(column[detail.batch]));
  const at = [0, 1].map((axis) => (middle ? middle[axis] - corner[axis] : (roi[axis] - 1) / 2));
  const p = detail.x.map((x) => x - at[0]), q = detail.y.map((y) => y - at[1]);
  const members = { one: () => 1, p: (k) => p[k] / lever, q: (k) => q[k] / lever, xx: (k) => p[k] * p[k] / square,
    xy: (k) => p[k] * q[k] / square, yy: (k) => q[k] * q[k] / square };
  return parameters.map(({ terms }) => terms.map((along) =>
    p.map((_, k) => along.reduce((sum, [member, sign]) => sum + sign * members[member](k), 0))));
}

/* How far the events move in half a batch, along x and y, at parameters v. */
function flow(detail, v) {
  detail.basis ??= basisOf(detail);
  return [0, 1].map((axis) => {
    const moved = new Float64Array(detail.events);
    v.forEach((value, i) => {
      const basis = detail.basis[i][axis];
      if (value && head.motion.parameters[i].terms[axis].length) {
        for (let k = 0; k < moved.length; ++k) moved[k] += value * basis[k];
      }
    });
    return moved;
  });
}

/* Image of events that move by u, with pixels 2^level px wide. */
function warpedImage(x, y, dt, [ux, uy], level) {
  const size = 2 ** level, width = Math.ceil(roi[0] / size), height = Math.ceil(roi[1] / size);
  const image = new Float64Array(width * height);
  for (let k = 0; k < x.length; ++k) {
    const wx = (x[k] - dt[k] * ux[k] + 0.5) / size - 0.5, wy = (y[k] - dt[k] * uy[k] + 0.5) / size - 0.5;
    const i = Math.floor(wx), j = Math.floor(wy), fx = wx - i, fy = wy - j;
    if (i < -1 || j < -1 || i >= width || j >= height) continue;
    const left = i >= 0, right = i + 1 < width, at = j * width + i;
    if (j >= 0) {
      if (left) image[at] += (1 - fx) * (1 - fy);
      if (right) image[at + 1] += fx * (1 - fy);
    }
    if (j + 1 < height) {
      if (left) image[at + width] += (1 - fx) * fy;
      if (right) image[at + width + 1] += fx * fy;
    }
  }
  return { image, width, height };
}

/* Population variance over the pixels of the ROI, those that a coarse image leaves empty included. */
function contrast(image) {
  const pixels = roi[0] * roi[1];
  let sum = 0, squares = 0;
  for (const value of image) { sum += value; squares += value * value; }
  return squares / pixels - (sum / pixels) ** 2;
}

function rows(flat, width, height) {
  return Array.from({ length: height }, (_, row) => flat.subarray(row * width, (row + 1) * width));
}

/* Contrast over two parameters; the others are those found. */
function landscapeOf(detail, level, [a, b]) {
  const points = detail.events > 12000 ? 17 : detail.events > 3000 ? 25 : 41, reach = head.reach;
  const axis = Array.from({ length: points }, (_, k) => reach * (2 * k / (points - 1) - 1));
  const x = dithered(detail.x, 0), y = dithered(detail.y, 1), dt = scaledTimes(detail);
  const z = axis.map((vb) => axis.map((va) => {
    const v = [...detail.v[detail.v.length - 1]];
    [v[a], v[b]] = [va, vb];
    return contrast(warpedImage(x, y, dt, flow(detail, v), level).image);
  }));
  return { axis, z };
}
