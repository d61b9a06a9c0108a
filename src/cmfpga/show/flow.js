/* The page of a run of dense flow: draws one window at a time on four canvases. */

const { windows, sensor, frame, tile, corners, grid } = head;
const SCALE = 4; // canvas pixels of a pixel of the sensor, where arrows are drawn
let raw;

function canvas(id, width, height) {
  const made = $(id);
  made.width = width;
  made.height = height;
  return made.getContext("2d");
}

function drawImage(id, index) {
  const [width, height] = frame, paper = canvas(id, width, height), image = paper.createImageData(width, height);
  const from = index * width * height;
  for (let k = 0; k < width * height; ++k) image.data.set([raw[from + k], raw[from + k], raw[from + k], 255], 4 * k);
  paper.putImageData(image, 0, 0);
}

/* Borders of the cells of one axis: half way between the middles of tiles. */
const borders = grid.map((places, axis) => [0, ...places.slice(1).map((place, k) =>
  (place + places[k] + tile[axis]) / 2), sensor[axis]]);

function cells(paper, fill) {
  const columns = grid[0].length;
  corners.forEach((_, k) => {
    const [i, j] = [k % columns, Math.floor(k / columns)];
    const [left, right, top, bottom] = [borders[0][i], borders[0][i + 1], borders[1][j], borders[1][j + 1]];
    fill(k, SCALE * left, SCALE * top, SCALE * (right - left), SCALE * (bottom - top));
  });
}

function arrow(paper, x, y, dx, dy) {
  const length = Math.hypot(dx, dy), angle = Math.atan2(dy, dx), tip = Math.min(0.4 * length, 3 * SCALE);
  paper.beginPath();
  paper.moveTo(x, y);
  paper.lineTo(x + dx, y + dy);
  for (const side of [-1, 1]) {
    paper.moveTo(x + dx, y + dy);
    paper.lineTo(x + dx - tip * Math.cos(angle + side * 0.5), y + dy - tip * Math.sin(angle + side * 0.5));
  }
  paper.stroke();
}

function drawFlow(one) {
  const paper = canvas("flow", SCALE * sensor[0], SCALE * sensor[1]);
  cells(paper, (k, ...box) => {
    paper.fillStyle = one.colours[k];
    paper.fillRect(...box);
  });
  const steps = grid[0].slice(1).map((place, k) => place - grid[0][k]);
  const step = Math.max(tile[0] / 2, ...steps) * SCALE;
  paper.strokeStyle = "#000000";
  paper.lineWidth = SCALE / 2;
  one.tiles.forEach(([, vx, vy], k) => {
    if (!one.trusted[k]) return;
    const middle = corners[k].map((at, axis) => SCALE * (at + tile[axis] / 2));
    arrow(paper, ...middle, step * vx / one.most, step * vy / one.most);
  });
  const radius = 22 * SCALE, [x, y] = [SCALE * sensor[0] - radius - 8, SCALE * sensor[1] - radius - 8];
  const rim = paper.createConicGradient(0, x, y), white = paper.createRadialGradient(x, y, 0, x, y, radius);
  head.wheel.forEach((colour, k) => rim.addColorStop(k / (head.wheel.length - 1), colour));
  ["#ffffffff", "#ffffff00"].forEach((colour, k) => white.addColorStop(k, colour));
  for (const style of [rim, white]) {
    paper.fillStyle = style;
    paper.beginPath();
    paper.arc(x, y, radius, 0, 2 * Math.PI);
    paper.fill();
  }
  paper.fillStyle = "#000000";
  paper.textAlign = "center";
  paper.font = `${7 * SCALE}px system-ui, sans-serif`;
  paper.fillText(`${one.most} px/s`, x, y + radius - 4);
  $("flow").setAttribute("aria-label", `Flow of ${corners.length} tiles in window ${one.window}.`);
}

function drawSure(one) {
  const paper = canvas("sure", SCALE * sensor[0], SCALE * sensor[1]);
  cells(paper, (k, left, top, width, height) => {
    const kappa = Number(one.tiles[k][3] || 0), level = Math.min(1, Math.max(0, Math.log10(Math.max(kappa, 1)) / 3));
    paper.fillStyle = one.tiles[k][3] === "" ? head.empty : `hsl(${250 - 190 * level} 70% ${18 + 52 * level}%)`;
    paper.fillRect(left, top, width, height);
    if (one.trusted[k] || one.tiles[k][3] === "") return;
    paper.strokeStyle = "#ffffff";
    paper.stroke(new Path2D(`M${left} ${top}l${width} ${height}m${-width} 0l${width} ${-height}`));
  });
  const count = one.trusted.reduce((sum, value) => sum + value, 0);
  $("share").textContent = `${count} of ${corners.length} tiles are to be trusted`;
  $("sure").setAttribute("aria-label", $("share").textContent);
}

function tell() {
  const one = windows[shown];
  const time = one.t === null ? "no events" : `${(one.t / 1e6).toFixed(4)} s, ${one.events} events`;
  const moved = one.moved === null ? "" : `, ${one.moved.toFixed(1)} px per half window`;
  $("where").textContent = `window ${one.window}: ${time}${moved}`;
  $("fit").textContent = one.fit === null ? "" : Object.entries(one.fit).filter(([name]) => !name.endsWith("_sd"))
    .slice(2).map(([name, value]) => `${name} ${value === null ? "—" : value}`).join(", ");
}

function draw() {
  const one = windows[shown];
  drawFlow(one);
  drawSure(one);
  ["still", "moved"].forEach((id, k) => {
    drawImage(id, 2 * shown + k);
    $(`${id}-value`).textContent = `contrast ${one.contrast[k]} (events/px)²`;
    $(id).setAttribute("aria-label", `Image of ${one.events} events: contrast ${one.contrast[k]}.`);
  });
  document.body.dataset.shown = one.window;
}

function point(event) {
  const box = event.target.getBoundingClientRect(), columns = grid[0].length;
  const [i, j] = [(event.clientX - box.left) / box.width * sensor[0], (event.clientY - box.top) / box.height * sensor[1]]
    .map((at, axis) => Math.max(0, borders[axis].findLastIndex((border, k) => k < grid[axis].length && border <= at)));
  const k = j * columns + i;
  $("pointed").textContent = [`x ${corners[k][0]}, y ${corners[k][1]}`, ...head.columns.map((name, n) =>
    `${name} ${windows[shown].tiles[k][n] === "" ? "—" : windows[shown].tiles[k][n]}`)].join(", ");
}

begin({
  count: windows.length,
  unpack(buffer) {
    raw = new Uint8Array(buffer);
    if (raw.length !== 2 * windows.length * frame[0] * frame[1]) throw new Error("its data are incomplete");
  },
  tell,
  draw,
  drawAll: draw,
  listen() {
    for (const id of ["flow", "sure"]) $(id).addEventListener("pointermove", point);
  },
});
