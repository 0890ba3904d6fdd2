/* An element with attributes and children: strings become text, never markup. */
function element(tag, attributes = {}, ...children) {
  const made = tag.startsWith("svg:")
    ? document.createElementNS("http://www.w3.org/2000/svg", tag.slice(4))
    : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/* 3D landmarks, joined by lines, on a canvas that turns by mouse, finger and keyboard.

No library: one with 3D, such as plotly, would add 4.5 MB to every page.

const view = drawWireframe(canvas, {
  points,   // [[x, y, z], …], drawn in the colour --face of CSS; may be empty
  lines,    // [[0, 1, 2], …] positions of the landmarks that each line joins
  title,    // said by screen readers
  names,    // of the landmarks; may be empty
  numbers,  // of the landmarks, as shown
  unit,     // of the points, beside the scale bar
  onPoint,  // called with the position of the landmark under the pointer, or null; optional, as
            // is all that follows
  surface,  // of shadedMesh: drawn behind the lines, in the colour of --surface (#rrggbb)
  around,   // points that shall be seen too, such as those of the surface
});
view.turnTo({yaw, pitch, roll}, ms);  // takes a quarter of a second, or so many milliseconds
view.reset();  view.showNumbers(true);
view.show(points, discs);  // others, with faint discs of these radii, in their unit
view.showSurface(true);  // null if there is none
view.mark(position);  // shows which landmark it is, null none
wireframeButtons(view, photo)  // → element with buttons; photo: angles of "as in the photo", or null

Points are in the frame of the face: +x to the subject's left, +y up, +z out of the face. Yaw is
positive when the head turns to its own left, pitch when it looks up, roll when its top leans to
its own right; they apply in this order, and all are 0 from the front. The camera is orthographic.
The size of the canvas is that of its CSS, which must set width and height (or aspect-ratio);
text takes the canvas' CSS colour and its halo the CSS background colour. */
"use strict";
const PIXELS = 120000; // of a surface at most: it is drawn in a few milliseconds

/* A number as it is shown: no sign of zero, and a true minus. */
function signed(value, digits = 0) {
  return value.toFixed(digits).replace(/^-(?=[0.]*$)/, "").replace("-", "−");
}

function drawWireframe(canvas, options) {
  const home = { yaw: -35, pitch: 10, roll: 0 };
  const { lines, title, names, numbers, unit, onPoint = () => {} } = options;
  const pen = canvas.getContext("2d");
  const every = [...options.points, ...(options.around ?? [])];
  const centre = [0, 1, 2].map((k) => {
    const values = every.map((point) => point[k]);
    return (Math.min(...values) + Math.max(...values)) / 2;
  });
  const radius = Math.max(...every.map((p) => Math.hypot(...p.map((v, k) => v - centre[k]))));
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  const wrapped = (angle) => angle - 360 * Math.round(angle / 360);
  let { points } = options, discs = [];
  let angles = { ...home }, zoom = 1, shift = [0, 0];
  let marked = null, numbered = false, visible = false, frame = 0, motion = 0;
  let { surface } = options, from = null; // where the pointer that is down was last

  /* Of a point relative to the centre: [right, up, towards the viewer]. */
  function turned([x, y, z]) {
    const [a, b, c] = [angles.yaw, angles.pitch, angles.roll].map((v) => (v * Math.PI) / 180);
    const right = x * Math.cos(a) + z * Math.sin(a), depth = z * Math.cos(a) - x * Math.sin(a);
    const up = y * Math.cos(b) + depth * Math.sin(b);
    return [
      right * Math.cos(c) - up * Math.sin(c),
      right * Math.sin(c) + up * Math.cos(c),
      depth * Math.cos(b) - y * Math.sin(b),
    ];
  }
  const middleOfCanvas = () => [canvas.clientWidth / 2, canvas.clientHeight / 2];
  const scale = () => (zoom * 0.44 * Math.min(canvas.clientWidth, canvas.clientHeight)) / radius;
  function seen(point) {
    const [right, up, depth] = turned(point.map((value, k) => value - centre[k]));
    const [x, y] = middleOfCanvas().map((value, k) => value + shift[k]);
    return [x + scale() * right, y - scale() * up, depth / radius];
  }
  const redraw = () => { if (visible) frame = frame || requestAnimationFrame(draw); };

  function draw() {
    cancelAnimationFrame(frame), frame = 0;
    const sharp = window.devicePixelRatio || 1, style = getComputedStyle(canvas);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width || !height) return;
    [canvas.width, canvas.height] = [Math.round(width * sharp), Math.round(height * sharp)];
    pen.scale(sharp, sharp);
    pen.lineCap = pen.lineJoin = "round";
    const colour = style.getPropertyValue("--face");
    const covers = surface
      ? drawSurface(width, height, style.getPropertyValue("--surface")) : () => false;
    const places = points.map(seen), marks = []; // what is drawn, with its depth
    for (const line of places.length ? lines : []) {
      for (let k = 1; k < line.length; k += 1) {
        const [a, b] = [places[line[k - 1]], places[line[k]]];
        marks.push({ depth: (a[2] + b[2]) / 2, a, b });
      }
    }
    for (const a of places) marks.push({ depth: a[2] + 0.01, a });
    [pen.strokeStyle, pen.fillStyle, pen.globalAlpha] = [colour, colour, 0.13];
    for (const [i, radius] of discs.entries()) {
      pen.beginPath(), pen.arc(places[i][0], places[i][1], scale() * radius, 0, 7), pen.fill();
    }
    for (const { depth, a, b } of marks.sort((m, n) => m.depth - n.depth)) {
      const near = Math.min(Math.max((depth + 0.8) / 1.6, 0), 1);
      // What is far is faint.
      pen.globalAlpha = covers(a, b ?? a) ? 0.1 : surface ? 1 : 0.28 + 0.72 * near;
      pen.lineWidth = 0.8 + near;
      pen.beginPath();
      if (b) pen.moveTo(a[0], a[1]), pen.lineTo(b[0], b[1]), pen.stroke();
      else pen.arc(a[0], a[1], 1.7 + 1.3 * near, 0, 7), pen.fill();
    }
    pen.globalAlpha = 1; // of text and axes
    if (numbered) drawNumbers(style);
    drawAxes(style, height);
    drawScaleBar(style, width, height);
    const stand = Object.entries(angles).map(([name, value]) => `${name} ${signed(value)}°`);
    write(style, stand.join("   "), 12, 20, "left");
    if (marked !== null) drawMark(style, width, colour);
  }

  function drawSurface(width, height, colour) {
    const fine = Math.sqrt(PIXELS / (width * height));
    const place = (point) => seen(point).map((value, k) => (k < 2 ? fine * value : value));
    const rgb = [1, 3, 5].map((k) => parseInt(colour.trim().slice(k, k + 2), 16));
    const sizes = [width, height].map((length) => Math.round(fine * length));
    const { image, depthAt } = surface(...sizes, place, turned, rgb);
    pen.drawImage(image, 0, 0, width, height);
    return (a, b) => {
      const [x, y, depth] = a.map((value, k) => (value + b[k]) / 2);
      return depthAt(fine * x, fine * y) > depth + 0.06;
    };
  }

  function write(style, text, x, y, align, size = 12) {
    pen.font = `${size}px system-ui, sans-serif`;
    pen.textAlign = align;
    pen.lineWidth = 3;
    pen.strokeStyle = style.backgroundColor;
    pen.strokeText(text, x, y);
    pen.fillStyle = style.color;
    pen.fillText(text, x, y);
  }

  function drawNumbers(style) {
    points.map(seen).forEach(([x, y, depth], i) => {
      pen.globalAlpha = Math.min(Math.max(0.75 + 0.5 * depth, 0.25), 1);
      write(style, numbers[i], x + 4, y - 4, "left", 10);
    });
    pen.globalAlpha = 1;
  }

  function drawAxes(style, height) {
    const [x, y, length] = [44, height - 42, 26];
    const axes = [["x", "#d1495b"], ["y", "#2f9e5a"], ["z", "#3f7fd1"]]
      .map(([name, colour], k) => ({ name, colour, end: turned([0, 1, 2].map((j) => +(j === k))) }))
      .sort((a, b) => a.end[2] - b.end[2]);
    for (const { name, colour, end: [right, up] } of axes) {
      [pen.strokeStyle, pen.lineWidth] = [colour, 2];
      pen.beginPath(), pen.moveTo(x, y), pen.lineTo(x + length * right, y - length * up);
      pen.stroke();
      write(style, name, x + (length + 9) * right, y - (length + 9) * up + 4, "center");
    }
  }

  function drawScaleBar(style, width, height) {
    const most = 90 / scale(), power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].find((step) => step * power <= most) * power;
    const [right, y] = [width - 16, height - 18], left = right - length * scale();
    [pen.strokeStyle, pen.lineWidth] = [style.color, 1.5];
    pen.beginPath();
    pen.moveTo(left, y - 4), pen.lineTo(left, y), pen.lineTo(right, y), pen.lineTo(right, y - 4);
    pen.stroke();
    write(style, `${Number(length.toPrecision(1))} ${unit}`, (left + right) / 2, y - 7, "center");
  }

  function drawMark(style, width, colour) {
    const point = points[marked], [x, y] = seen(point), digits = radius < 10 ? 3 : 1;
    [pen.strokeStyle, pen.lineWidth] = [style.color, 2];
    pen.beginPath(), pen.arc(x, y, 6, 0, 7), pen.stroke();
    const heading = `${numbers[marked]} ${(names[marked] ?? "").replaceAll("_", " ")}`;
    const where = ["x", "y", "z"].map((axis, k) => `${axis} ${point[k].toFixed(digits)}`);
    pen.font = "12px system-ui, sans-serif";
    const text = [heading, `${where.join("  ").replaceAll("-", "−")} ${unit}`];
    const wide = Math.max(...text.map((line) => pen.measureText(line).width)) + 16;
    const [left, top] = [Math.max(4, Math.min(x + 12, width - wide - 4)), y > 64 ? y - 54 : y + 14];
    pen.fillStyle = style.backgroundColor;
    [pen.strokeStyle, pen.lineWidth] = [colour, 1];
    pen.beginPath(), pen.rect(left, top, wide, 40), pen.fill(), pen.stroke();
    text.forEach((line, k) => write(style, line, left + 8, top + 16 + 17 * k, "left"));
  }

  function mark(landmark) {
    if (landmark === marked) return;
    marked = landmark;
    onPoint(landmark);
    redraw();
  }
  function nearest([x, y], within) {
    let best = null, least = within;
    points.map(seen).forEach(([px, py, depth], landmark) => {
      const away = Math.hypot(px - x, py - y) - depth; // of equal ones that in front
      if (away < least) [best, least] = [landmark, away];
    });
    return best;
  }

  function turn(yaw, pitch) {
    cancelAnimationFrame(motion);
    angles.yaw = wrapped(angles.yaw + yaw);
    angles.pitch = Math.min(Math.max(angles.pitch + pitch, -90), 90);
    redraw();
  }
  function zoomBy(factor, fixed = middleOfCanvas()) {
    const next = Math.min(Math.max(zoom * factor, 0.5), 12), by = next / zoom;
    const about = middleOfCanvas().map((value, k) => fixed[k] - value);
    shift = shift.map((value, k) => about[k] - by * (about[k] - value)); // what is there stays there
    zoom = next;
    redraw();
  }
  function turnTo(target, ms = 250) {
    cancelAnimationFrame(motion);
    const from = { ...angles }, begun = performance.now();
    from.yaw = target.yaw - wrapped(target.yaw - from.yaw); // the shorter way round
    const to = { yaw: target.yaw, pitch: target.pitch, roll: target.roll };
    const step = (now) => {
      const t = calm.matches || !ms ? 1 : Math.min(Math.max((now - begun) / ms, 0), 1);
      const eased = t * t * (3 - 2 * t);
      for (const name in to) angles[name] = from[name] + eased * (to[name] - from[name]);
      if (t < 1) motion = requestAnimationFrame(step);
      redraw();
    };
    step(begun);
  }
  function reset() {
    [zoom, shift] = [1, [0, 0]], turnTo(home);
  }

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left - canvas.clientLeft, event.clientY - box.top - canvas.clientTop];
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    from = place(event);
    mark(nearest(place(event), 16));
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = place(event);
    if (!from) return mark(nearest(now, 12));
    const [right, down] = now.map((value, k) => value - from[k]);
    from = now;
    if (!event.shiftKey) return turn(0.5 * right, -0.5 * down);
    shift = [shift[0] + right, shift[1] + down];
    redraw();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, () => { from = null; });
  }
  canvas.addEventListener("pointerleave", // a finger that taps leaves, too, and wants to read
    (event) => event.pointerType === "mouse" && mark(null));
  canvas.addEventListener("wheel", (event) => {
    // Else the wheel would stop scrolling the page whenever a canvas comes under the pointer.
    if (document.activeElement !== canvas && !event.ctrlKey) return;
    event.preventDefault();
    zoomBy(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), place(event));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => turn(-5, 0), ArrowRight: () => turn(5, 0),
    ArrowUp: () => turn(0, 5), ArrowDown: () => turn(0, -5),
    "+": () => zoomBy(1.15), "-": () => zoomBy(1 / 1.15), 0: reset,
  };
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault(), keys[event.key]();
  });
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application"); // arrow keys are for the canvas
  canvas.setAttribute("aria-roledescription", "3D view");
  canvas.setAttribute("aria-label",
    `${title}. Arrow keys turn, plus and minus zoom, 0 goes back to the first view.`);
  canvas.style.touchAction = "pan-y"; // a finger that starts sideways turns, else the page scrolls

  new ResizeObserver(redraw).observe(canvas);
  new IntersectionObserver((entries) => {
    visible = entries.at(-1).isIntersecting;
    if (visible) draw();
    else canvas.width = canvas.height = 0; // gives the memory of hundreds of faces back
  }, { rootMargin: "50%" }).observe(canvas);
  for (const query of ["(prefers-color-scheme: dark)", "print"]) {
    matchMedia(query).addEventListener("change", () => (visible || query === "print") && draw());
  }
  return {
    turnTo, reset, mark,
    show(others, radii) {
      [points, discs, marked] = [others, radii, others.length ? marked : null];
      redraw();
    },
    showNumbers: (on) => { numbered = on; redraw(); },
    showSurface: options.surface
      ? (on) => { surface = on ? options.surface : null; redraw(); } : null,
  };
}

/* A button that stays pressed until it is clicked again; `show` is called with whether it is. */
function toggleButton(text, pressed, show) {
  const button = element("button", { type: "button", "aria-pressed": pressed }, text);
  button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", on);
    show(on);
  });
  return button;
}

function wireframeButtons(view, photo = null) {
  const bar = element("div", { class: "wireframe-buttons" });
  const add = (text, action) => {
    const button = element("button", { type: "button" }, text);
    button.addEventListener("click", action);
    bar.append(button);
  };
  add("Front", () => view.turnTo({ yaw: 0, pitch: 0, roll: 0 }));
  add("Side", () => view.turnTo({ yaw: 90, pitch: 0, roll: 0 }));
  if (photo) add("As in the photo", () => view.turnTo(photo));
  add("Reset", view.reset);
  bar.append(toggleButton("Numbers", false, view.showNumbers));
  if (view.showSurface) bar.append(toggleButton("Surface", true, view.showSurface));
  return bar;
}

/* A triangle mesh, shaded, by a rasteriser without WebGL.

WebGL gives a page some sixteen contexts, and a page may have hundreds of faces.

const surface = shadedMesh(vertices, triangles);  // Float32Array of x, y, z; Uint16Array of corners
const seen = surface(width, height, place, turned, rgb);  // → {image, depthAt}

`place` takes a point to [x, y] in pixels, as an affine map may, with the depth towards the viewer
third; `turned` turns a direction to the viewer's axes; `rgb` is the colour. `image` is a canvas,
`depthAt(x, y)` the depth of the nearest point there, -Infinity where there is none. */
function shadedMesh(vertices, triangles) {
  const n = vertices.length / 3;
  const normals = new Float32Array(3 * n);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const [ux, uy, uz] = [0, 1, 2].map((k) => vertices[b + k] - vertices[a + k]);
    const [vx, vy, vz] = [0, 1, 2].map((k) => vertices[c + k] - vertices[a + k]);
    const area = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const corner of [a, b, c]) for (let k = 0; k < 3; k += 1) normals[corner + k] += area[k];
  }
  for (let i = 0; i < 3 * n; i += 3) {
    const length = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    for (let k = 0; k < 3; k += 1) normals[i + k] /= length;
  }
  const [xs, ys, zs, lights] = [0, 0, 0, 0].map(() => new Float32Array(n));
  const canvas = document.createElement("canvas"), pen = canvas.getContext("2d");
  let depth, image, pixels;

  function triangle(a, b, c, tones) {
    const { width, height } = canvas, [ax, ay, bx, by] = [xs[a], ys[a], xs[b], ys[b]];
    const [cx, cy] = [xs[c], ys[c]], area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
    if (!area) return;
    // Of the right side of the surface the corners go round clockwise, y being down.
    const inside = area > 0; // seen at an open edge, as below the neck: one tone, in shade
    const left = Math.max(0, Math.ceil(Math.min(ax, bx, cx)));
    const right = Math.min(width - 1, Math.floor(Math.max(ax, bx, cx)));
    const top = Math.max(0, Math.ceil(Math.min(ay, by, cy)));
    const bottom = Math.min(height - 1, Math.floor(Math.max(ay, by, cy)));
    // Weights of b and c change by these from a pixel to the next, and from a row to the next.
    const bdx = (cy - ay) / area, bdy = (ax - cx) / area;
    const cdx = (ay - by) / area, cdy = (bx - ax) / area;
    const [za, zb, zc] = [zs[a], zs[b] - zs[a], zs[c] - zs[a]];
    const [la, lb, lc] = [lights[a], lights[b] - lights[a], lights[c] - lights[a]];
    const edge = -1e-4; // else pixels on an edge of two triangles are in neither, by rounding
    for (let y = top; y <= bottom; y += 1) {
      let wb = (left - ax) * bdx + (y - ay) * bdy, wc = (left - ax) * cdx + (y - ay) * cdy;
      for (let x = left, i = y * width + left; x <= right; x += 1, i += 1, wb += bdx, wc += cdx) {
        if (wb < edge || wc < edge || wb + wc > 1 - edge) continue;
        const z = za + wb * zb + wc * zc;
        if (z <= depth[i]) continue;
        depth[i] = z;
        pixels[i] = tones[inside ? 120 : (la + wb * lb + wc * lc) | 0];
      }
    }
  }

  return (width, height, place, turned, rgb) => {
    if (canvas.width !== width || canvas.height !== height || !image) {
      [canvas.width, canvas.height] = [width, height];
      image = pen.createImageData(width, height);
      [pixels, depth] = [new Uint32Array(image.data.buffer), new Float32Array(width * height)];
    }
    depth.fill(-Infinity), pixels.fill(0);
    // Affine maps are known by where they take the origin and the axes.
    const [o, ...ends] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]].map(place);
    const steps = ends.map((end) => end.map((value, k) => value - o[k]));
    const sun = [-0.3, 0.45, 0.84]; // from the viewer's upper left
    const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(turned);
    const [lx, ly, lz] = axes.map((axis) => axis.reduce((sum, value, k) => sum + value * sun[k], 0));
    for (let i = 0, j = 0; i < n; i += 1, j += 3) {
      const [x, y, z] = [vertices[j], vertices[j + 1], vertices[j + 2]];
      xs[i] = o[0] + x * steps[0][0] + y * steps[1][0] + z * steps[2][0];
      ys[i] = o[1] + x * steps[0][1] + y * steps[1][1] + z * steps[2][1];
      zs[i] = o[2] + x * steps[0][2] + y * steps[1][2] + z * steps[2][2];
      const bright = lx * normals[j] + ly * normals[j + 1] + lz * normals[j + 2];
      lights[i] = 255 * (0.4 + 0.6 * Math.max(bright, 0));
    }
    const bytes = new Uint8ClampedArray(4 * 256), tones = new Uint32Array(bytes.buffer);
    for (let tone = 0; tone < 256; tone += 1) {
      bytes.set([...rgb.map((value) => (value * tone) / 255), 255], 4 * tone);
    }
    for (let t = 0; t < triangles.length; t += 3) {
      triangle(triangles[t], triangles[t + 1], triangles[t + 2], tones);
    }
    pen.putImageData(image, 0, 0);
    const depthAt = (x, y) => depth[Math.round(y) * width + Math.round(x)] ?? -Infinity;
    return { image: canvas, depthAt };
  };
}

/* Numbers that a page holds as base64: little-endian, as all browsers have them. */
function decoded(base64, Numbers) {
  return new Numbers(Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0)).buffer);
}
