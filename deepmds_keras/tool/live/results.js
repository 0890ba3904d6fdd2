/* What was seen since the start, as files that `deepmds predict` writes and reads. */
"use strict";

const KEPT = 18000; // faces, a quarter of an hour of one: 30 MB

/* Files of one run of a camera, photo or video; `about` is what Python says of their content. */
function recorder(source, about, { names, numbers }) {
  const records = [];
  const COLUMNS = "face,frame,time,track,smoothed,number,name,x,y,z,std_x,std_y,std_z,"
    + "image_x,image_y\n";
  const FIELDS = ["shape", "std", "landmarks"];
  const nameOf = ({ frame, track }) => `${source}-${frame}-${track}`;
  const digits = (value) => +value.toPrecision(7);

  function csvOf(record) {
    const { frame, time, track, smoothed } = record;
    const name = `"${nameOf(record).replaceAll('"', '""')}"`;
    const start = [name, frame, digits(time), track, +smoothed].join(",");
    return names.map((landmark, i) => {
      const cells = FIELDS.flatMap((field) => {
        const width = record[field].length / names.length;
        return [...record[field].subarray(i * width, (i + 1) * width)].map(digits);
      });
      return `${start},${numbers[i]},${landmark},${cells.join(",")}\n`;
    }).join("");
  }
  function jsonOf(record) {
    const { frame, time, track, smoothed, pose } = record;
    const arrays = FIELDS.map((field) => {
      const flat = Array.from(record[field], digits), width = flat.length / names.length;
      return [field, names.map((_, i) => flat.slice(i * width, (i + 1) * width))];
    });
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
