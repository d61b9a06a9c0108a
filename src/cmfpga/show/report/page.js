/* Last part: tables and controls; begins the work. */

/* Index of the detail nearest to a batch. */
function nearest(batch) {
  return details.reduce((best, detail, k) =>
    Math.abs(detail.batch - batch) < Math.abs(details[best].batch - batch) ? k : best, 0);
}

function cell(tag, text) {
  const made = document.createElement(tag);
  made.textContent = text;
  return made;
}

function build() {
  const add = (label, unit, fill) => {
    const box = document.createElement("div"), value = document.createElement("dd"), number = document.createElement("span");
    fill(number);
    value.append(number);
    if (unit) { const note = cell("span", ` ${unit}`); note.className = "unit"; value.append(note); }
    box.append(cell("dt", label), value);
    $("numbers").append(box);
  };
  for (const name of Object.keys(columns)) add(...head.labels[name], (number) => { number.dataset.column = name; });
  add("the batch lasts", "ms", (number) => { number.id = "lasts"; });
  add("computing takes", "ms", (number) => { number.id = "takes"; });
  add("real-time margin", "times", (number) => { number.id = "times"; });

  const top = document.createElement("tr");
  for (const name of Object.keys(columns)) top.append(cell("th", name));
  $("table").append(top);
  for (let k = 0; k < Math.min(batches, 5000); ++k) {
    const row = document.createElement("tr");
    row.dataset.batch = k;
    row.className = warnings(k).length ? "flagged" : "";
    for (const values of Object.values(columns)) row.append(cell("td", values[k]));
    row.addEventListener("click", () => go(nearest(k)));
    $("table").append(row);
  }
  for (const k of flagged.slice(0, 5000)) {
    const mark = document.createElement("i");
    mark.style.left = `${100 * k / batches}%`;
    mark.style.width = `max(3px, ${100 / batches}%)`;
    $("strip").append(mark);
  }
}

function play() {
  if (playing) { clearInterval(playing); playing = null; } else {
    if (shown === details.length - 1) go(0);
    playing = setInterval(() => (shown === details.length - 1 ? play() : go(shown + 1)), 350);
  }
  $("play").textContent = playing ? "❚❚ stop" : "▶ play";
}

/* What the buttons below the landscape say. */
function chosen() {
  const value = (name) => document.querySelector(`input[name=${name}]:checked`)?.value;
  level = Number(value("level") ?? level);
  pair = value("pair")?.split(",").map(Number) ?? pair;
}

function listen() {
  const slider = $("slider");
  slider.max = details.length - 1;
  slider.addEventListener("input", () => go(Number(slider.value)));
  $("previous").addEventListener("click", () => go(shown - 1));
  $("next").addEventListener("click", () => go(shown + 1));
  $("play").addEventListener("click", play);
  const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: 10, PageDown: -10, Home: -Infinity, End: Infinity };
  document.addEventListener("keydown", (event) => {
    const step = steps[event.key];
    if (step === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    const inside = event.target.closest?.("input[type=radio], .scroll");
    // Away from the slider, the keys that scroll the page go on doing so.
    if (inside || (event.target !== slider && !event.key.startsWith("Arrow"))) return;
    event.preventDefault();
    go(shown + step);
  });
  for (const id of CHARTS) $(id).on("plotly_click", ({ points }) => go(nearest(Number(points[0].customdata))));
  for (const choice of document.querySelectorAll("input[name=level], input[name=pair]")) {
    choice.addEventListener("change", () => { chosen(); drawLandscape(details[shown]); });
  }
  $("theme").addEventListener("click", () => {
    const root = document.documentElement, now = getComputedStyle(root).colorScheme;
    root.dataset.theme = now === "dark" ? "light" : "dark";
    drawAll();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  // Paper is white.
  let before;
  window.addEventListener("beforeprint", () => {
    before = document.documentElement.dataset.theme;
    document.documentElement.dataset.theme = "light";
    drawAll();
  });
  window.addEventListener("afterprint", () => {
    if (before) document.documentElement.dataset.theme = before; else delete document.documentElement.dataset.theme;
    drawAll();
  });
}

(async () => {
  try {
    await unpack();
    chosen();
    build();
    drawAll();
    listen();
    document.body.dataset.ready = "yes";
  } catch (error) {
    $("problem").textContent = `This browser cannot draw the report: ${error.message}`;
    $("problem").hidden = false;
    throw error;
  }
})();
