/* Runs the graph of `lifting/traced.py` for one face, in double precision.

const run = compiled(graph);
const { shape } = run({ view, visible, landmark_sd });  // flat arrays; the next run overwrites them

The sizes of all arrays are known, so that they, and where each element is read from, are laid out
once. Kinds of nodes are ONNX's. */
"use strict";

const product = (dims) => dims.reduce((sum, n) => sum * n, 1);
const zeros = (dims) => ({ dims, data: new Float64Array(product(dims)) });

/* Steps from an element to the next along each axis. */
const stepsOf = (dims) => dims.map((_, axis) => product(dims.slice(axis + 1)));

/* Where elements lie, in order, if they begin at `first` and axes have these steps. */
function placesOf(dims, steps, first = 0) {
  const along = (places, axis) => places.flatMap((place) =>
    Array.from({ length: dims[axis] }, (_, i) => place + i * steps[axis]));
  return Int32Array.from([...dims.keys()].reduce(along, [first]));
}

/* Steps by which an array is read as if it had other dims: 0 where it is repeated. */
function stretched(array, dims) {
  const skipped = dims.length - array.dims.length, steps = stepsOf(array.dims);
  return dims.map((_, axis) => (array.dims[axis - skipped] > 1 ? steps[axis - skipped] : 0));
}
function commonDims(arrays) {
  const rank = Math.max(...arrays.map(({ dims }) => dims.length));
  return Array.from({ length: rank }, (_, axis) =>
    Math.max(...arrays.map(({ dims }) => dims[axis - rank + dims.length] ?? 1)));
}

const ELEMENTWISE = {
  Exp: Math.exp, Log: Math.log, Sqrt: Math.sqrt, Tanh: Math.tanh, Neg: (a) => -a,
  Add: (a, b) => a + b, Sub: (a, b) => a - b, Mul: (a, b) => a * b, Div: (a, b) => a / b,
  Max: (a, b) => (a > b ? a : b), Clip: (a, low, high) => Math.min(Math.max(a, low), high),
  And: (a, b) => a && b, Or: (a, b) => a || b, Not: (a) => +!a, IsNaN: (a) => +Number.isNaN(a),
  Where: (a, b, c) => (a ? b : c),
};
function elementwise(kind, arrays) {
  const map = ELEMENTWISE[kind], out = zeros(commonDims(arrays));
  const [a, b, c] = arrays.map((array) => array.data);
  const [i, j, k] = arrays.map((array) => placesOf(out.dims, stretched(array, out.dims)));
  const { data } = out, n = data.length;
  out.fill = [
    () => { for (let t = 0; t < n; t += 1) data[t] = map(a[i[t]]); },
    () => { for (let t = 0; t < n; t += 1) data[t] = map(a[i[t]], b[j[t]]); },
    () => { for (let t = 0; t < n; t += 1) data[t] = map(a[i[t]], b[j[t]], c[k[t]]); },
  ][arrays.length - 1];
  return out;
}

function picked(array, dims, steps, first = 0) {
  const places = placesOf(dims, steps, first), out = zeros(dims);
  out.fill = () => places.forEach((place, i) => { out.data[i] = array.data[place]; });
  return out;
}

function summed(array, axes, keepdims, share) {
  const kept = array.dims.map((n, axis) => (axes.includes(axis) ? 1 : n));
  const places = placesOf(array.dims, stretched({ dims: kept }, array.dims));
  const out = zeros(keepdims ? kept : kept.filter((_, axis) => !axes.includes(axis)));
  out.fill = () => {
    out.data.fill(0);
    places.forEach((place, i) => { out.data[place] += share * array.data[i]; });
  };
  return out;
}

/* kind → (inputs, attributes) → the output; `fill` computes it, unless it is a view of an input. */
const NODES = {
  Cast: ([{ dims, data }]) => ({ dims, data }),
  Squeeze: ([{ dims, data }, axes]) =>
    ({ dims: dims.filter((_, axis) => !axes.data.includes(axis)), data }),
  Unsqueeze([{ dims, data }, axes]) {
    const out = [...dims];
    axes.data.forEach((axis) => out.splice(axis, 0, 1));
    return { dims: out, data };
  },
  Reshape([{ data }, { data: wanted }]) {
    return { dims: wanted.map((n) => (n < 0 ? -data.length / product(wanted) : n)), data };
  },
  Slice([array, starts, ends, axes]) {
    const dims = [...array.dims], steps = stepsOf(dims);
    let first = 0;
    axes.data.forEach((axis, i) => {
      const [start, end] = [starts, ends].map(({ data }) =>
        Math.min(data[i] < 0 ? data[i] + array.dims[axis] : data[i], array.dims[axis]));
      dims[axis] = end - start, first += start * steps[axis];
    });
    return picked(array, dims, steps, first);
  },
  Transpose([array], { perm }) {
    const steps = stepsOf(array.dims);
    return picked(array, perm.map((axis) => array.dims[axis]), perm.map((axis) => steps[axis]));
  },
  Concat(arrays, { axis }) {
    const dims = [...arrays[0].dims];
    dims[axis] = arrays.reduce((sum, array) => sum + array.dims[axis], 0);
    const out = zeros(dims), steps = stepsOf(dims);
    let first = 0;
    const places = arrays.map((array) => {
      const here = placesOf(array.dims, steps, first);
      first += array.dims[axis] * steps[axis];
      return here;
    });
    out.fill = () => arrays.forEach(({ data }, k) =>
      places[k].forEach((place, i) => { out.data[place] = data[i]; }));
    return out;
  },
  ReduceSum: ([array, axes], { keepdims }) => summed(array, axes.data, keepdims, 1),
  ReduceMean: ([array, axes], { keepdims }) =>
    summed(array, axes.data, keepdims, 1 / product(axes.data.map((axis) => array.dims[axis]))),
  MatMul([a, b]) {
    const [rows, inner, columns] = [a.dims.at(-2), a.dims.at(-1), b.dims.at(-1)];
    const batch = [a, b].map(({ dims }) => ({ dims: dims.slice(0, -2) }));
    const lead = commonDims(batch), out = zeros([...lead, rows, columns]);
    const [ofA, ofB] = batch.map((each) => placesOf(lead, stretched(each, lead)));
    out.fill = () => {
      out.data.fill(0);
      ofA.forEach((which, n) => {
        for (let i = 0; i < rows; i += 1) for (let k = 0; k < inner; k += 1) {
          const factor = a.data[(which * rows + i) * inner + k];
          const to = (n * rows + i) * columns, from = (ofB[n] * inner + k) * columns;
          for (let j = 0; j < columns; j += 1) out.data[to + j] += factor * b.data[from + j];
        }
      });
    };
    return out;
  },
};

function compiled({ inputs, constants, nodes, outputs }) {
  const arrays = {}, fills = [];
  for (const [name, dims] of Object.entries(inputs)) arrays[name] = zeros(dims);
  for (const [name, { dims, floats, whole }] of Object.entries(constants)) {
    arrays[name] = { dims, data: whole ?? Float64Array.from(decoded(floats, Float32Array)) };
  }
  for (const [kind, names, output, attributes] of nodes) {
    const given = names.map((name) => arrays[name]);
    const out = NODES[kind] ? NODES[kind](given, attributes) : elementwise(kind, given);
    arrays[output] = out;
    if (out.fill) fills.push(out.fill);
  }
  return (values) => {
    for (const name in inputs) arrays[name].data.set(values[name]);
    fills.forEach((fill) => fill());
    return Object.fromEntries(
      Object.entries(outputs).map(([name, output]) => [name, arrays[output].data]));
  };
}
