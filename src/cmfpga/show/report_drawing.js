/* First of the two parts of the report's script: all numbers come from the data in the page; images of warped events
   and contrasts are computed here from the batch's events, by the equations of cmfpga.imaging.iwe.
   Then one batch is drawn, and the charts over time. */

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

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const config = { displayModeBar: false, responsive: true, scrollZoom: false, doubleClick: false };

function axisLook(title, more = {}) {
  return { title: { text: title, standoff: 6 }, gridcolor: css("--grid"), zerolinecolor: css("--line"),
    linecolor: css("--line"), automargin: true, fixedrange: true, ...more };
}

function layout(x, y, more = {}) {
  return {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", dragmode: false, hovermode: "closest",
    font: { color: css("--ink"), family: "system-ui, sans-serif", size: 12 }, margin: { l: 48, r: 10, t: 8, b: 40 },
    showlegend: false, xaxis: x, yaxis: y, transition: { duration: 0 }, ...more,
  };
}

/* Beside the picture, or below it where there is little width. */
function colorbar(text) {
  const below = innerWidth <= 760;
  return { title: { text, side: below ? "top" : "right" }, thickness: 12, outlinewidth: 0,
    ...(below ? { orientation: "h", y: -0.2, yanchor: "top" } : {}) };
}

const legend = { orientation: "h", x: 0, y: 1.02, yanchor: "bottom", bgcolor: "rgba(0,0,0,0)" };

/* Numbers of a column; NaN where there is none. */
const numbers = (name) => columns[name].map((text) => (text === "" ? NaN : Number(text)));
const seconds = (() => {
  const times = numbers("t_ref_us"), first = times.find((time) => !Number.isNaN(time)) ?? 0;
  return times.map((time) => (time - first) / 1e6);
})();
const centres = columns.batch.map((_, k) =>
  [Number(columns.roi_x[k]) + (roi[0] - 1) / 2, Number(columns.roi_y[k]) + (roi[1] - 1) / 2]);

function describe(id, text) {
  $(id).setAttribute("aria-label", text);
}

/* A picture in pixels, y downwards, that keeps its shape. */
function drawPicture(id, data, [x, y], [width, height], more = {}) {
  const look = { constrain: "domain", showgrid: false, zeroline: false };
  Plotly.react(id, data, layout(axisLook(x, { range: [-0.5, width - 0.5], ...look }),
    axisLook(y, { range: [height - 0.5, -0.5], scaleanchor: "x", ...look }), more), config);
}

function drawFrame(detail) {
  const [side, width, height] = head.frame, k = detail.batch;
  const [left, top] = [Number(columns.roi_x[k]), Number(columns.roi_y[k])];
  const line = (points, style) => ({ type: "scatter", mode: "lines", hoverinfo: "skip",
    x: points.map((p) => p[0]), y: points.map((p) => p[1]), line: { color: css("--trail"), width: 2.5, ...style } });
  const end = [head.roiNext[0] + (roi[0] - 1) / 2, head.roiNext[1] + (roi[1] - 1) / 2];
  const [cx, cy] = centres[k];
  const data = [
    { type: "heatmap", z: rows(detail.frame, width, height), x0: (side - 1) / 2, dx: side, y0: (side - 1) / 2, dy: side,
      zmin: 0, zmax: 2, showscale: false, colorscale: [[0, css("--empty")], [1, css("--event")]],
      hovertemplate: "x %{x} px, y %{y} px: %{z} events<extra></extra>" },
    line([...centres.slice(k), end], { dash: "dot", width: 1.5 }),
    line(centres.slice(0, k + 1), {}),
    { type: "scatter", mode: "markers", hoverinfo: "skip", x: [cx], y: [cy],
      marker: { color: css("--trail"), size: 7, line: { color: css("--empty"), width: 1 } } },
  ];
  const box = { type: "rect", x0: left - 0.5, y0: top - 0.5, x1: left + roi[0] - 0.5, y1: top + roi[1] - 0.5,
    line: { color: css("--roi"), width: 3 } };
  drawPicture("frame", data, ["x [px]", "y [px]"], sensor, { shapes: [box] });
  describe("frame", `${columns.events[k]} events of ${head.one} ${k} on the sensor of ${sensor[0]} by ${sensor[1]} px; ` +
    `the ROI is at ${left}, ${top} px.`);
}

function drawImages(detail) {
  const k = detail.batch, dt = scaledTimes(detail);
  const { parameters } = head.motion, none = parameters.map(() => 0);
  const v = detail.levels.length ? detail.v[detail.v.length - 1] : none;
  const [still, moved] = [none, v].map((at) => warpedImage(detail.x, detail.y, dt, flow(detail, at), 0));
  const found = parameters.length === 2 ? `v = (${v.map((value) => value.toFixed(2)).join(", ")})`
    : parameters.map(({ title }, k) => `${title.split(",")[0]} = ${v[k].toFixed(2)}`).join(", ");
  // The brightest fifth of a percent would make all else dark.
  const sorted = Float64Array.from(moved.image).sort();
  const top = Math.max(1, sorted[Math.floor(0.998 * (sorted.length - 1))]);
  const values = { still: contrast(still.image), moved: contrast(moved.image) };
  for (const [id, picture, name] of [["still", still, "v = 0"],
    ["moved", moved, `${found} px/half ${head.one}`]]) {
    const data = [{ type: "heatmap", z: rows(picture.image, picture.width, picture.height), zmin: 0, zmax: top,
      colorscale: "Viridis", colorbar: colorbar("events per px"),
      hovertemplate: "x %{x}, y %{y} px: %{z:.2f} events<extra></extra>" }];
    const text = `${name}: contrast ${values[id].toFixed(3)} (events/px)²`;
    $(`${id}-value`).textContent = text;
    drawPicture(id, data, ["x in the ROI [px]", "y in the ROI [px]"], roi);
    $(id).dataset.contrast = values[id];
    $(id).dataset.top = top;
    describe(id, `Image of warped events of ${head.one} ${k} at ${text}.`);
  }
}

const STEPS = [["circle", 8], ["square", 10], ["diamond", 13], ["diamond", 16]];

function drawLandscape(detail) {
  const { axis, z } = landscapeOf(detail, level, pair), [a, b] = pair;
  const [across, down] = pair.map((k) => head.motion.parameters[k]);
  const data = [{ type: "heatmap", x: axis, y: axis, z, colorscale: "Cividis", zsmooth: "best",
    colorbar: colorbar("contrast [(events/px)²]"),
    hovertemplate: `${across.title} = %{x:.2f}, ${down.title} = %{y:.2f} px/half ${head.one}: contrast %{z:.3f}<extra></extra>` }];
  const path = detail.v, steps = detail.levels, traced = path.length > steps.length;
  for (const each of traced ? new Set(steps) : []) {
    const used = path.map((_, i) => i).filter((i) => i < steps.length && steps[i] === each);
    const [symbol, size] = STEPS[Math.min(each, 3)];
    const points = used.flatMap((i) => [path[i], path[i + 1], path[i].map(() => null)]);
    data.push({ type: "scatter", mode: "lines", hoverinfo: "skip", x: points.map((p) => p[a]), y: points.map((p) => p[b]),
      line: { color: "#ffffff", width: each === level ? 3 : 1.5 } });
    data.push({ type: "scatter", mode: "markers", name: `pixels of ${2 ** each} px`, x: used.map((i) => path[i + 1][a]),
      y: used.map((i) => path[i + 1][b]), text: used.map((i) => `after iteration ${i + 1} of ${steps.length}`),
      marker: { symbol, size: steps.length > 40 ? size / 2 : size, color: each === level ? "#ffffff" : "#9a9a9a",
        line: { color: "#000000", width: 1 } },
      hovertemplate: `%{text}, pixels of ${2 ** each} px: v = (%{x:.3f}, %{y:.3f}) px/half ${head.one}<extra></extra>` });
  }
  if (steps.length) {
    const [first, last] = [path[0], path[path.length - 1]];
    data.push({ type: "scatter", mode: "markers", x: [last[a]], y: [last[b]], marker: { symbol: "star", size: 17,
      color: "#e69f00", line: { color: "#000000", width: 1.5 } },
      hovertemplate: `found: v = (%{x:.3f}, %{y:.3f}) px/half ${head.one}<extra></extra>` });
    if (traced) data.push({ type: "scatter", mode: "markers", x: [first[a]], y: [first[b]],
      marker: { symbol: "circle-open", size: 22, color: "#ffffff", line: { width: 3 } },
      hovertemplate: "start: v = (%{x:.3f}, %{y:.3f})<extra></extra>" });
  }
  Plotly.react("landscape", data, layout(
    axisLook(`${across.title} [${across.unit}]`, { range: [-head.reach, head.reach], constrain: "domain", showgrid: false }),
    axisLook(`${down.title} [${down.unit}]`, { range: [head.reach, -head.reach], scaleanchor: "x", constrain: "domain",
      showgrid: false })), config);
  describe("landscape", `Contrast over ${across.title} and ${down.title} with pixels of ${2 ** level} px, ${head.one} ${detail.batch}: ` +
    (steps.length ? `the ascent goes ${traced ? `from (${path[0]}) ` : ""}to (${path[path.length - 1]}) px per half ${head.one} ` +
      `in ${steps.length} iterations.` : "no ascent, nothing was measured."));
}

const named = (k) => (columns.flags[k] ? columns.flags[k].split("|") : []);
const warnings = (k) => named(k).filter((name) => !head.notes.includes(name));
const flagged = columns.flags.map((_, k) => (warnings(k).length ? k : -1)).filter((k) => k >= 0);

/* The line at the batch that is shown, for a chart over time; and what its points do. */
function cursor() {
  const at = seconds[details[shown].batch];
  return Number.isNaN(at) ? [] : [{ type: "line", x0: at, x1: at, yref: "paper", y0: 0, y1: 1,
    line: { color: css("--soft"), width: 2, dash: "dash" } }];
}

const CHARTS = [...head.motion.charts.map(() => "rates"), "velocity", "margin", "inside", "cycles"];

function series(name, y, colour, more = {}) {
  const { line, marker, ...rest } = more;
  return { type: "scatter", mode: batches > 300 ? "lines" : "lines+markers", name, x: seconds, y, customdata: columns.batch,
    line: { color: css(colour), width: 2, ...line }, marker: { size: 6, color: css(colour), ...marker },
    hovertemplate: `${head.one} %{customdata}: %{y} — ${name}<extra></extra>`, ...rest };
}

/* Triangles on the axis of time where a batch has warnings. */
function flagMarks() {
  return { type: "scatter", mode: "markers", name: "warnings", x: flagged.map((k) => seconds[k]), y: flagged.map(() => 0),
    yaxis: "y2", customdata: flagged, text: flagged.map((k) => warnings(k).join("|")), cliponaxis: false,
    showlegend: flagged.length > 0,
    marker: { symbol: "triangle-up", size: 10, color: css("--warn") }, hovertemplate: `${head.one} %{customdata}: %{text}<extra></extra>` };
}

function drawChart(id, data, title, more = {}) {
  const known = seconds.filter((time) => !Number.isNaN(time));
  const edge = 0.02 * (known[known.length - 1] - known[0]) || 0.01;
  Plotly.react(id, [...data, flagMarks()], layout(
    axisLook("time [s]", { range: [known[0] - edge, known[known.length - 1] + edge] }), axisLook(title, more),
    { shapes: cursor(), showlegend: true, legend, margin: { l: 56, r: 10, t: 30, b: 40 },
      yaxis2: { overlaying: "y", range: [0, 1], visible: false, fixedrange: true } }), config);
}

function drawCharts() {
  const velocity = [
    series("vx, to the right", numbers("vx_px_per_s"), "--vx"),
    series("vy, downwards", numbers("vy_px_per_s"), "--vy", { marker: { symbol: "square" } }),
  ];
  for (const [axis, name] of head.truths.some((pair) => pair[0] !== null) ? ["vx", "vy"].entries() : []) {
    velocity.push(series(`true ${name}`, head.truths.map((pair) => pair[axis]), `--${name}`,
      { mode: "lines", line: { dash: "dash" } }));
  }
  const looks = [["--vx", "circle"], ["--vy", "square"], ["--soft", "diamond"]];
  for (const { label, lines } of head.motion.charts) {
    const rates = Object.entries(lines).map(([name, shown], k) => {
      const [colour, symbol] = looks[k];
      return series(shown, numbers(name), colour, { marker: { symbol } });
    });
    drawChart("rates", rates, label);
    describe("rates", `${label} over time; the table of all ${head.many} has the numbers.`);
  }
  drawChart("velocity", velocity, "velocity [px/s]");
  describe("velocity", `Velocity of the object over time in px/s; the table of all ${head.many} has the numbers.`);
  const ms = (values) => values.map((value) => (value === null || value === 0 ? NaN : value / 1000));
  const [lasts, takes] = [ms(head.lasts), ms(head.computeUs)], all = [...lasts, ...takes].filter((time) => time > 0);
  // Ticks at powers of ten, where there would be two at least.
  const wide = Math.max(...all) / Math.min(...all) > 100;
  drawChart("margin", [
    series(`${head.due} lasts`, lasts, "--vx"),
    series("computing takes", takes, "--vy", { marker: { symbol: "square" } }),
  ], "time [ms]", { type: "log", ...(wide ? { dtick: 1 } : {}) });
  describe("margin", `Time that ${head.due} lasts and time to compute it, in ms, on a logarithmic scale.`);
  const inside = [series("events in the ROI", numbers("roi_events"), "--vx")];
  if (head.bufferShown) {
    inside.push(series("buffer", seconds.map(() => head.bufferEvents), "--vy", { mode: "lines", line: { dash: "dash" } }));
  }
  drawChart("inside", inside, "events", { rangemode: "tozero" });
  describe("inside", `Events in the ROI of each ${head.one}.`);
  const label = head.byFormula ? "cycles by the formula" : "cycles counted";
  drawChart("cycles", [series(label, head.cycles, "--vx")], "clock cycles", { rangemode: "tozero" });
  describe("cycles", `Clock cycles of each ${head.one}.`);
}

function showNumbers(detail) {
  const k = detail.batch;
  for (const [name, values] of Object.entries(columns)) {
    document.querySelector(`[data-column="${name}"]`).textContent = values[k] === "" ? missing : values[k];
  }
  const margin = head.margin[k], time = head.computeUs[k];
  const digits = (value) => (value === null ? missing : Number(value.toPrecision(3)).toLocaleString("en"));
  $("lasts").textContent = digits(head.lasts[k] / 1000);
  $("takes").textContent = digits(time === null ? null : time / 1000);
  $("times").textContent = digits(margin);
  const names = named(k), warned = warnings(k).length > 0;
  $("flags").className = warned ? "set" : "";
  $("flags").textContent = (warned ? "⚠ " : "") + (names.map((name) => `${name}: ${head.flags[name]}`).join("; ")
    || `No warnings: nothing unusual in this ${head.one}.`);
  const at = columns.t_ref_us[k] === "" ? "" : `, ${seconds[k].toFixed(3)} s`;
  $("where").textContent = `${head.one} ${k} of ${batches - 1}${at}`;
  for (const row of document.querySelectorAll("tr.now")) row.classList.remove("now");
  document.querySelector(`tr[data-batch="${k}"]`)?.classList.add("now");
}

function draw() {
  const detail = details[shown];
  drawFrame(detail);
  drawImages(detail);
  drawLandscape(detail);
  for (const id of CHARTS) if ($(id).data) Plotly.relayout(id, { shapes: cursor() });
  document.body.dataset.shown = detail.batch;
}

function drawAll() {
  drawCharts();
  draw();
}
