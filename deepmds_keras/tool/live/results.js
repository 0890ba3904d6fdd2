/* What was seen since the start, as files that `deepmds predict` writes and reads. */
"use strict";

const KEPT = 18000; // faces, a quarter of an hour of one: 30 MB, 86 MB as JSON

/* Files of one run of a camera, photo or video; `about` is what Python says of their content. */
function recorder(source, about, { names, numbers }) {
  const records = [];
  const COLUMNS = "face,frame,time,track,smoothed,number,name,x,y,z,std_x,std_y,std_z,"
    + "image_x,image_y\n";
  const FIELDS = ["shape", "std", "landmarks"];
  const nameOf = ({ frame, track }) => `${source}-${frame}-${track}`;
  const digits = (value) => +value.toPrecision(7);
  const rowsOf = (flat) => { // of each landmark
    const width = flat.length / names.length;
    return names.map((_, i) => Array.from(flat.subarray(i * width, (i + 1) * width), digits));
  };

  function csvOf(record) {
    const { frame, time, track, smoothed } = record;
    const name = `"${nameOf(record).replaceAll('"', '""')}"`;
    const start = [name, frame, digits(time), track, +smoothed];
    const [shape, std, landmarks] = FIELDS.map((field) => rowsOf(record[field]));
    return names.map((landmark, i) => {
      const row = [...start, numbers[i], landmark, ...shape[i], ...std[i], ...landmarks[i]];
      return `${row.join(",")}\n`;
    }).join("");
  }
  function jsonOf(record) {
    const { frame, time, track, smoothed, pose } = record;
    const arrays = FIELDS.map((field) => [field, rowsOf(record[field])]);
    return JSON.stringify({ name: nameOf(record), source, frame, time, track, smoothed, pose,
      ...Object.fromEntries(arrays) });
  }
  return {
    records,
    add(face) {
      const flat = FIELDS.map((field) => [field, Float32Array.from(face[field].flat())]);
      records.push({ ...face, ...Object.fromEntries(flat) });
      if (records.length > KEPT) records.shift();
    },
    csv: () => [...about.csv.map((line) => `# ${line}\n`), COLUMNS, ...records.map(csvOf)],
    json: () => [JSON.stringify(about.json).slice(0, -1), ',"faces":[',
      ...records.map((record, i) => (i ? ",\n" : "\n") + jsonOf(record)), "\n]}\n"],
  };
}

function save(name, type, parts) {
  const href = URL.createObjectURL(new Blob(parts, { type }));
  element("a", { href, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(href), 60000); // once it is written
}
