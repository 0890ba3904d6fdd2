/* A triangle mesh, shaded, by a rasteriser of our own.

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
