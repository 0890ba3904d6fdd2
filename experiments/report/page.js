/* Tables that sort by the column whose heading is pressed, and faces that turn. */
"use strict";

const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹", SECONDS = { h: 3600, min: 60, s: 1 };

/* The first number of a text: with its power of ten, of a time in seconds; null if there is none. */
function numberIn(text) {
  const plain = text.replace(/,/g, "").replace(/−/g, "-");
  if (/^\d{4}-\d\d-\d\d /.test(plain)) return Date.parse(plain.replace(" ", "T"));
  const times = [...plain.matchAll(/([\d.]+) (h|min|s)\b/g)];
  if (times.length) return times.reduce((sum, [, n, unit]) => sum + n * SECONDS[unit], 0);
  const number = plain.match(/[-+]?\d[\d.]*(e[-+]?\d+)?/);
  if (!number) return null;
  const [, sign, digits] = plain.match(/10(⁻?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+)/) ?? ["", "", "⁰"];
  const power = [...digits].map((digit) => SUPERSCRIPTS.indexOf(digit)).join("");
  return Number(number[0]) * 10 ** (sign ? -power : +power);
}

/* Text of a cell without the marks of its notes. */
const textOf = (cell) => [...cell.childNodes].filter((node) => node.nodeName !== "SUP")
  .map((node) => node.textContent).join("").trim();

function sortBy(heading, column, table) {
  const falling = heading.getAttribute("aria-sort") === "ascending";
  const numeric = heading.classList.contains("number");
  const key = (row) => {
    const text = textOf(row.cells[column]);
    return numeric ? numberIn(text) : text;
  };
  const compare = (a, b) => (numeric ? a - b : a.localeCompare(b, "en"));
  const body = table.tBodies[0];
  const rows = [...body.rows].map((row) => [key(row), row]).sort(([a], [b]) => {
    if (a === null || b === null) return (a === null) - (b === null); // empty cells are last
    return falling ? compare(b, a) : compare(a, b);
  });
  body.append(...rows.map(([, row]) => row));
  for (const other of table.tHead.querySelectorAll("[aria-sort]")) {
    other.setAttribute("aria-sort", "none");
  }
  heading.setAttribute("aria-sort", falling ? "descending" : "ascending");
}

/* Headings that sort; "MSE: here" and "MSE: paper" stand below what they have in common. */
function dressHead(table) {
  const [row] = table.tHead.rows, top = element("tr");
  [...row.cells].forEach((heading, column) => {
    const title = heading.textContent, [name, group] = title.split(": ").reverse();
    const button = element("button", { type: "button", "aria-label": `${title}: sort` }, name);
    button.addEventListener("click", () => sortBy(heading, column, table));
    heading.setAttribute("aria-sort", "none");
    heading.replaceChildren(button);
    const last = top.lastElementChild;
    if (group && last?.textContent === group) last.colSpan += 1;
    else if (group) top.append(element("th", { scope: "colgroup" }, group));
    else top.append(heading);
  });
  if (!row.cells.length) row.replaceWith(top);
  else if (top.cells.length) {
    row.before(top);
    for (const heading of top.querySelectorAll("[aria-sort]")) heading.rowSpan = 2;
  }
}

document.querySelectorAll("table").forEach(dressHead);

/* The landmarks that went in, to fill a square: x to the right, y up. */
function viewOf(face, lines) {
  const [low, high] = [Math.min, Math.max].map((end) =>
    [0, 1].map((axis) => end(...face.view.map((point) => point[axis]))));
  const size = Math.max(high[0] - low[0], high[1] - low[1]);
  const points = face.view.map(([x, y]) => [
    0.5 + (x - (low[0] + high[0]) / 2) / size, 0.5 - (y - (low[1] + high[1]) / 2) / size,
  ]);
  const drawing = element("svg:svg", { viewBox: "-0.08 -0.08 1.16 1.16", role: "img",
    "aria-label": "The 2D landmarks that went in" });
  for (const line of lines) {
    drawing.append(element("svg:polyline", { points: line.map((i) => points[i].join(",")).join(" ") }));
  }
  drawing.append(...points.map(([cx, cy]) => element("svg:circle", { cx, cy, r: 0.009 })));
  return drawing;
}

/* In the place of the words that stand for the faces, under their heading. */
function showFaces([anchor, data]) {
  const box = element("div", { class: "faces" });
  document.getElementById(anchor).nextElementSibling.replaceWith(box);
  const { faces, methods, polylines, names, numbers } = data;
  const shapeOf = (face, points, name, colour) => ({
    name, colour, points: points.map((point) => point.map((value) => value * face.unit_mm)),
  });
  const truthOf = (face) => shapeOf(face, face.truth, "Truth", "#9a9a9a");
  const canvas = element("canvas");
  const choice = element("select", {},
    ...faces.map((face, k) => element("option", { value: k }, face.title)));
  const input = element("div");
  const boxes = ["truth", ...Object.keys(methods)].map((method) => {
    const tick = element("input", { type: "checkbox", value: method });
    tick.checked = method === "truth" || method === "ours";
    const patch = element("i", { class: "patch" });
    patch.style.background = methods[method]?.colour ?? "#9a9a9a";
    const error = element("span");
    const name = methods[method]?.title ?? "Truth";
    return { method, name, tick, error, label: element("label", {}, tick, patch, name, error) };
  });
  const left = element("div", {}, canvas);
  box.append(left, element("div", {},
    element("fieldset", {}, element("legend", {}, "Face"), choice),
    element("fieldset", {}, element("legend", {}, "Landmarks that went in"), input),
    element("fieldset", {}, element("legend", {}, "Shapes shown"), ...boxes.map((b) => b.label))));

  const view = drawWireframe(canvas, {
    shapes: faces.map(truthOf), lines: polylines, names, numbers, unit: "mm",
    title: `3D faces of: ${data.title}`,
  });
  left.append(wireframeButtons(view));

  function show() {
    const face = faces[choice.value];
    input.replaceChildren(viewOf(face, polylines));
    const shapes = [];
    for (const { method, name, tick, error } of boxes) {
      const points = method === "truth" ? face.truth : face.shapes[method];
      tick.disabled = !points;
      error.textContent = points ? "" : "(face not found)";
      if (!points || !tick.checked) continue;
      shapes.push(method === "truth" ? truthOf(face)
        : shapeOf(face, points, name, methods[method].colour));
    }
    view.show(shapes);
  }
  for (const control of [choice, ...boxes.map((b) => b.tick)]) {
    control.addEventListener("change", show);
  }
  show();
}

Object.entries(JSON.parse(document.getElementById("faces").textContent)).forEach(showFaces);

/* Paper has no folds. */
window.addEventListener("beforeprint", () => {
  for (const fold of document.querySelectorAll("details")) fold.open = true;
});
