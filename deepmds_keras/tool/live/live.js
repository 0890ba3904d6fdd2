/* The page: opens camera, photos and videos, draws what is found in them, and says it. */
"use strict";

const MOST_FACES = 4;
const BEYOND = 5; // degrees past those of the training that are still no guess: errors of a pose
const NO_WEBGL = "This browser has no WebGL, which MediaPipe needs. Turn hardware acceleration on, "
  + "or take another browser.";
const ASKED = "The browser asks whether this page may use the camera. Answer it first.";
const NO_CAMERA = {
  NotAllowedError: "The camera is not allowed. Allow it for this page, by the sign next to its "
    + "address, then press Camera again.",
  NotFoundError: "No camera is found. Connect one, or open a photo or a video.",
  NotReadableError: "The camera cannot be read. Another program may be using it.",
};

const at = (id) => document.getElementById(id);
const settings = JSON.parse(at("settings").textContent);
const { scheme } = settings;
const run = compiled(settings.graph);
const view = drawWireframe(at("shape"), {
  points: [], lines: scheme.lines, names: scheme.names, numbers: scheme.numbers, unit: "units",
  title: "The face in 3D", around: settings.around,
});
at("turns").append(wireframeButtons(view));

function say(text) {
  if (at("said").textContent !== text) at("said").textContent = text; // else it is read out again
}

async function unpacked(id) {
  const bytes = new Blob([decoded(at(id).textContent, Uint8Array)]);
  const stream = bytes.stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
async function openFinder() {
  const canvas = element("canvas");
  if (!canvas.getContext("webgl2") && !canvas.getContext("webgl")) throw new Error(NO_WEBGL);
  const [wasm, modelAssetBuffer] = await Promise.all(["wasm", "model"].map(unpacked));
  const wasmBinaryPath = URL.createObjectURL(new Blob([wasm], { type: "application/wasm" }));
  return self.FaceLandmarker.createFromOptions({ wasmBinaryPath }, {
    baseOptions: { modelAssetBuffer, delegate: "CPU" },
    runningMode: "VIDEO",
    numFaces: MOST_FACES,
  });
}

let follow, record; // of what is shown now
let playing = null; // the video that is analysed, or null
let frame = 0, times = []; // of the frames shown last, milliseconds

function begin(source) {
  [follow, record, frame, times] = [follower(), recorder(source, settings.about, scheme), 0, []];
}
function stop() {
  if (!playing) return;
  playing.pause();
  playing.srcObject?.getTracks().forEach((track) => track.stop());
  if (playing.src) URL.revokeObjectURL(playing.src);
  playing = null;
  at("stop").disabled = true;
  say("Stopped.");
}

function tell(face, count) {
  const { yaw, pitch, roll } = face?.pose ?? {};
  const beyond = Object.entries(settings.turns)
    .filter(([name, most]) => Math.abs(face?.pose[name]) > most + BEYOND)
    .map(([name, most]) => `${name} beyond the ±${most}° of the training: a guess`);
  const sd = face?.discs, worst = sd && Math.max(...sd);
  const recent = times.slice(-31);
  const rate = (1000 * (recent.length - 1)) / (recent.at(-1) - recent[0]);
  at("pose").textContent = face
    ? [`yaw ${signed(yaw)}°, pitch ${signed(pitch)}°, roll ${signed(roll)}°`, ...beyond].join("; ")
    : "–";
  at("sd").textContent = face
    ? `${mean(sd).toFixed(3)} on average, at most ${worst.toFixed(3)} `
      + `(${scheme.names[sd.indexOf(worst)].replaceAll("_", " ")})`
    : "–";
  at("speed").textContent = recent.length > 2 ? `${rate.toFixed(0)} frames/s` : "–";
  const { length } = record.records;
  at("kept").textContent = length < KEPT
    ? `${length} (${count} in this frame)` : `the last ${KEPT}, older ones are dropped`;
  at("csv").disabled = at("json").disabled = !length;
}

function drawPhoto(image, width, height, faces) {
  const canvas = at("photo"), pen = canvas.getContext("2d");
  [canvas.width, canvas.height] = [width, height];
  pen.drawImage(image, 0, 0, width, height);
  const fine = Math.max(width, height) / 640;
  pen.font = `${16 * fine}px system-ui, sans-serif`;
  for (const { landmarks, track } of faces) {
    [pen.lineWidth, pen.strokeStyle, pen.fillStyle] = [1.2 * fine, "#ff9448", "#ffd000"];
    for (const line of scheme.lines) {
      pen.beginPath();
      for (const i of line) pen.lineTo(...landmarks[i]);
      pen.stroke();
    }
    for (const [x, y] of landmarks) pen.beginPath(), pen.arc(x, y, 1.6 * fine, 0, 7), pen.fill();
    if (faces.length > 1) {
      const [left, top] = [0, 1].map((k) => Math.min(...landmarks.map((point) => point[k])));
      [pen.lineWidth, pen.strokeStyle] = [3 * fine, "#000"];
      pen.strokeText(track, left, top - 6 * fine), pen.fillText(track, left, top - 6 * fine);
    }
  }
}

/* Shows a picture and the faces that MediaPipe finds in it; `time` is in seconds. */
function show(image, width, height, time, { faceLandmarks }) {
  const isSmooth = image === playing && at("smooth").checked;
  const found = faceLandmarks.map((points) =>
    landmarksOf(points, settings.detector, width, height));
  const faces = follow(found, time, isSmooth).map(({ track, landmarks }) => {
    const face = lifted(run, landmarks, settings.detector.sd);
    const discs = face.std.map((xyz) => Math.sqrt(mean(xyz.map((value) => value ** 2))));
    record.add({ frame, time, track, smoothed: isSmooth, landmarks, ...face });
    return { track, landmarks, discs, ...face };
  });
  drawPhoto(image, width, height, faces);
  // The one that has been there longest.
  const shown = faces.toSorted((one, other) => one.track - other.track)[0];
  view.show(shown?.shape ?? [], (at("discs").checked && shown?.discs) || []);
  if (shown && at("follow").checked) view.turnTo(shown.pose, 0);
  frame += 1, times = [...times.slice(-31), performance.now()];
  tell(shown, faces.length);
  say(faces.length ? "" : "No face is found. It should be at least a fifth of the picture wide, "
    + "upright and in good light.");
}

async function play(video, source) {
  Object.assign(video, { muted: true, playsInline: true });
  await finder.setOptions({ runningMode: "VIDEO" }); // forgets where faces were
  await video.play();
  begin(source);
  playing = video;
  at("stop").disabled = false;
  let first = null;
  const next = () => video.requestVideoFrameCallback((_, { mediaTime }) => attempt(() => {
    if (playing !== video) return;
    first ??= mediaTime;
    show(video, video.videoWidth, video.videoHeight, mediaTime - first,
      finder.detectForVideo(video, performance.now()));
    next();
  }));
  video.addEventListener("ended", () => { if (playing === video) stop(); });
  video.addEventListener("error", () => { // damaged, or cut off
    if (playing === video) stop(), say("The rest of the video cannot be read.");
  });
  next();
}

async function openCamera() {
  if (!navigator.mediaDevices) throw new Error("This browser gives no camera to pages in files.");
  const stream = await navigator.mediaDevices
    .getUserMedia({ video: { width: { ideal: 640 }, height: { ideal: 480 } } })
    .catch((error) => { throw new Error(NO_CAMERA[error.name] ?? error.message); });
  const video = element("video");
  video.srcObject = stream;
  stream.getTracks()[0].addEventListener("ended", () => { // unplugged, or no longer allowed
    if (playing === video) stop(), say("The camera has stopped.");
  });
  await play(video, "camera");
}

async function openFile(file) {
  const source = file.name.replace(/\.[^.]*$/, "");
  const refuse = () => {
    throw new Error(`${file.name} must be a photo or a video that this browser can open.`);
  };
  if (file.type.startsWith("video/")) {
    const video = element("video", { src: URL.createObjectURL(file) });
    return play(video, source).then(() => {
      if (!video.videoWidth) stop(), refuse(); // sound alone, or pictures that it cannot decode
    }, refuse);
  }
  const image = await createImageBitmap(file).catch(refuse); // upright, whatever its tag
  await finder.setOptions({ runningMode: "IMAGE" });
  begin(source);
  show(image, image.width, image.height, 0, finder.detect(image));
}

let finder = null;
const ready = openFinder().then((opened) => {
  finder = opened;
  say("Ready: open a camera, a photo or a video.");
});
function attempt(action) {
  try { return action(); } catch (error) { stop(), say(error.message); }
}

let opening = null, next = null; // one at a time, then the last that was asked for meanwhile
async function open(action) {
  if (action !== opening) next = action;
  if (opening === openCamera) say(ASKED);
  if (opening) return;
  while ((opening = next)) {
    next = null;
    try {
      await ready;
      stop();
      await opening();
    } catch (error) {
      say(error.message);
    }
  }
}
open(() => {});
at("camera").addEventListener("click", () => open(openCamera));
at("stop").addEventListener("click", stop);
at("open").addEventListener("click", () => at("file").click());
at("file").addEventListener("change", () => {
  const [file] = at("file").files;
  if (file) open(() => openFile(file));
  at("file").value = ""; // so that the same file can be opened again
});
at("csv").addEventListener("click", () => save("faces.csv", "text/csv", record.csv()));
at("json").addEventListener("click", () => save("faces.json", "application/json", record.json()));
for (const name of ["pointerdown", "keydown"]) { // who turns the face by hand has it stay so
  at("shape").addEventListener(name, (event) => {
    if (event.key !== "Tab") at("follow").checked = false;
  });
}
at("turns").addEventListener("click", (event) => {
  if (!event.target.hasAttribute("aria-pressed")) at("follow").checked = false;
});
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  const [file] = event.dataTransfer.files;
  if (file) open(() => openFile(file));
});
