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
  for (const [label, unit, id] of [[`${head.due} lasts`, "ms", "lasts"], ["computing takes", "ms", "takes"],
    ["real-time margin", "times", "times"]]) add(label, unit, (number) => { number.id = id; });

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

/* What the buttons below the landscape say. */
function chosen() {
  const value = (name) => document.querySelector(`input[name=${name}]:checked`)?.value;
  level = Number(value("level") ?? level);
  pair = value("pair")?.split(",").map(Number) ?? pair;
}

begin({
  count: details.length,
  unpack(raw) {
    unpack(raw);
    chosen();
    build();
  },
  tell: () => showNumbers(details[shown]),
  draw,
  drawAll,
  listen() {
    for (const id of CHARTS) $(id).on("plotly_click", ({ points }) => go(nearest(Number(points[0].customdata))));
    for (const choice of document.querySelectorAll("input[name=level], input[name=pair]")) {
      choice.addEventListener("change", () => { chosen(); drawLandscape(details[shown]); });
    }
  },
});
