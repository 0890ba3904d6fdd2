"""Stage 1 of the FLAME track: frames of expressions, the training set, and their views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from data_gen.datasets.coma import find_meshes, load_coma
from data_gen.datasets.dataset import Dataset, dataset_of, save_dataset
from data_gen.datasets.frames_standin import make_frames
from data_gen.models.flame_embedding import embedding_near
from data_gen.models.morphable_model import MorphableModel
from data_gen.models.registry import load_model
from data_gen.views.projections import sample_cameras
from experiments.arguments import parse_run
from experiments.inputs import in_photos
from experiments.progress import Bar
from experiments.records import write_text
from experiments.run import Run
from experiments.running import stage
from experiments.streams import Stream


def coma_frames(run: Run, folder: Path, record: dict) -> tuple[np.ndarray, dict]:
    """Landmarks `(n, 51, 3)` of all meshes of CoMA, millimetres; what cannot be read is listed."""
    embedding = embedding_near(run.data or folder)
    with Bar(total=len(find_meshes(folder)), desc="meshes", unit="mesh") as bar:
        coma = load_coma(folder, embedding, jobs=run.jobs, progress=bar.update)
    record["skipped"] = len(coma.skipped)
    if coma.skipped:
        lines = "".join(f"{path}: {reason}\n" for path, reason in coma.skipped)
        write_text(run.work / "frames-skipped.txt", lines)
        print(f"  {len(coma.skipped)} meshes skipped, see {run.work / 'frames-skipped.txt'}")
    return coma.landmarks, {"frames": "CoMA"}


def standin_frames(
    run: Run, model: MorphableModel, rng: np.random.Generator
) -> tuple[np.ndarray, dict]:
    """Landmarks `(n, 51, 3)` of as many frames of the open stand-in, millimetres."""
    frames = make_frames(model, run.preset.frame_subjects, run.preset.frames, rng)
    landmarks = model.restrict(model.landmarks[run.scheme])
    source = {"frames": f"stand-in, {model.name}"}
    return landmarks.shape(frames.identity, frames.expression), source


def make_training_set(run: Run, model: MorphableModel, record: dict) -> Dataset:
    """The frames, one view of each."""
    rng = np.random.default_rng([run.seed, Stream.FRAMES])
    folder = run.folder_of("coma")
    landmarks, source = (
        standin_frames(run, model, rng) if folder is None else coma_frames(run, folder, record)
    )
    record |= source | {"n_frames": len(landmarks)}
    cameras = sample_cameras(len(landmarks), rng, run.protocol)
    description = {"model": run.model, "scheme": run.scheme, "protocol": run.protocol, **source}
    return in_photos(run, dataset_of(landmarks, cameras, description))


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "frames") as record:
        model = load_model(run.model, run.data, run.scheme)
        record |= {"model": model.name, "model_sha256": model.sha256}
        save_dataset(run.work / "train.npz", make_training_set(run, model, record))
