/* Tables that sort by the column whose heading is pressed, and faces that turn. */
"use strict";

/* Place of a heading among the cells of a row; headings of one row may span two. */
function columnOf(heading, table) {
  const [top, bottom] = table.tHead.rows;
  if (!bottom) return heading.cellIndex;
  let column = 0, below = 0;
  for (const cell of top.cells) {
    if (cell === heading) return column;
    if (cell.scope === "colgroup") {
      for (let k = 0; k < cell.colSpan; k += 1, below += 1, column += 1) {
        if (bottom.cells[below] === heading) return column;
      }
    } else column += 1;
  }
  return -1;
}

function sortBy(heading, table) {
  const falling = heading.getAttribute("aria-sort") === "ascending";
  const column = columnOf(heading, table), numeric = heading.classList.contains("number");
  const key = (row) => {
    const cell = row.cells[column];
    if (numeric) return cell.dataset.value === undefined ? null : Number(cell.dataset.value);
    return cell.textContent.trim();
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

for (const table of document.querySelectorAll("table.sortable")) {
  for (const button of table.tHead.querySelectorAll("button")) {
    button.addEventListener("click", () => sortBy(button.closest("th"), table));
  }
}

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

function showFaces(box) {
  const data = JSON.parse(box.querySelector("script").textContent);
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

document.querySelectorAll(".faces").forEach(showFaces);

/* Paper has no folds. */
window.addEventListener("beforeprint", () => {
  for (const fold of document.querySelectorAll("details")) fold.open = true;
});
