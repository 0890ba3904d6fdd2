/* From the points that MediaPipe finds to landmarks, followed over time, and shapes. */
"use strict";

const LOST = 1; // seconds after which a face that comes back is another
const REACH = 2; // radii that a face moves at most from a frame to the next; neighbours are 4 apart

const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
const middleOf = (points) => [0, 1].map((k) => mean(points.map((point) => point[k])));
/* The root mean square distance from the middle. */
function radiusOf(points) {
  const [x, y] = middleOf(points);
  return Math.sqrt(mean(points.map((point) => (point[0] - x) ** 2 + (point[1] - y) ** 2)));
}

/* Landmarks in pixels, y down, moved to where iBUG 300-W has them: `to_ibug` in Python. */
function landmarksOf(points, { picks, down, offsets }, width, height) {
  const found = picks.map((pick) => [points[pick].x * width, points[pick].y * height]);
  const axis = [0, 1].map((k) => found.reduce((sum, point, i) => sum + down[i] * point[k], 0));
  const [x, y] = axis.map((value) => value / Math.hypot(...axis)), radius = radiusOf(found);
  return found.map((point, i) => {
    const [across, along] = offsets[i];
    return [point[0] + radius * (across * y + along * x),
      point[1] + radius * (along * y - across * x)];
  });
}

/* The One Euro filter (Casiez, Roussel and Vogel 2012, doi:10.1145/2207676.2208639).

A slow face is smoothed much, against jitter, a fast one little, lest the landmarks lag. Speeds are
in radii of the face, so that its size in the picture does not matter. */
const CUTOFF = 1, GAIN = 5; // hertz; of a still face, and more for each radius a second
function smoothed(past, landmarks, time) {
  const speeds = landmarks.map(() => [0, 0]);
  if (!past || time <= past.time) return { landmarks, speeds, time };
  const radius = radiusOf(landmarks), seconds = time - past.time;
  const share = (hertz) => 1 / (1 + 1 / (2 * Math.PI * hertz * seconds));
  const kept = landmarks.map((point, i) => point.map((value, k) => {
    const [before, speed] = [past.landmarks[i][k], past.speeds[i][k]];
    speeds[i][k] = speed + share(1) * ((value - before) / seconds - speed);
    return before + share(CUTOFF + (GAIN * Math.abs(speeds[i][k])) / radius) * (value - before);
  }));
  return { landmarks: kept, speeds, time };
}

/* A function of the landmarks of the faces of a frame, and of its time in seconds.

It returns `{track, landmarks}` of each face, the largest first in the first frame: its number,
which it keeps from frame to frame, and its landmarks, smoothed if that is asked for. */
function follower() {
  let tracks = [], count = 0, last = 0;
  return (faces, time, isSmooth) => {
    tracks = tracks.filter((track) => last - track.time < LOST); // however late this frame is
    last = time;
    const pairs = faces.flatMap((landmarks) => tracks.map((track) => {
      const [here, there] = [landmarks, track.landmarks].map(middleOf);
      const away = Math.hypot(here[0] - there[0], here[1] - there[1]) / radiusOf(landmarks);
      return { landmarks, track, away };
    })).filter(({ away }) => away < REACH).sort((one, other) => one.away - other.away);
    const known = new Map(); // landmarks → track: the nearest first, each once
    for (const { landmarks, track } of pairs) {
      const isTaken = [...known.values()].includes(track);
      if (!known.has(landmarks) && !isTaken) known.set(landmarks, track);
    }
    return faces.toSorted((one, other) => radiusOf(other) - radiusOf(one)).map((landmarks) => {
      let track = known.get(landmarks);
      if (!track) tracks.push(track = { number: count += 1 });
      const past = isSmooth && track.landmarks ? track : null;
      Object.assign(track, smoothed(past, landmarks, time));
      return { track: track.number, landmarks: track.landmarks };
    });
  };
}

/* Shape and standard deviations, `[[x, y, z], …]`, and the head's angles in degrees. */
function lifted(run, landmarks, sd) {
  const radius = radiusOf(landmarks);
  const { shape, shape_sd: std, rotation: r } = run({
    view: landmarks.flatMap(([x, y]) => [x, -y]),
    visible: sd.map(() => 1),
    landmark_sd: sd.map((value) => radius * value),
  });
  const degrees = (...sides) => (180 / Math.PI) * Math.atan2(...sides);
  const threes = (flat) => landmarks.map((_, i) => [...flat.subarray(3 * i, 3 * i + 3)]);
  return {
    shape: threes(shape),
    std: threes(std),
    pose: { yaw: degrees(-r[6], r[8]), pitch: degrees(-r[7], Math.hypot(r[6], r[8])),
      roll: degrees(-r[1], r[4]) },
  };
}
