"""Step of the FLAME track: frames of expressions, the training set, and their views."""

from pathlib import Path

import numpy as np

from data_gen.datasets.coma import find_meshes, load_coma
from data_gen.datasets.dataset import dataset_of, make_performances, save_dataset
from data_gen.models.flame import load_embedding
from data_gen.views import sample_cameras
from experiments.inputs import embedding_file, face_model, in_photos
from experiments.progress import Progress
from experiments.records import write_text
from experiments.run import Run
from experiments.streams import Stream


def coma_frames(run: Run, folder: Path) -> tuple[np.ndarray, int]:
    """Landmarks `(n, 51, 3)` of the meshes of CoMA, millimetres, and how many were unreadable."""
    embedding = load_embedding(embedding_file(run))
    with Progress("mesh", len(find_meshes(folder))) as bar:
        landmarks, skipped = load_coma(folder, embedding, jobs=run.jobs, progress=bar.update)
    if skipped:
        path = run.work / "frames-skipped.txt"
        write_text(path, "".join(f"{mesh}: {reason}\n" for mesh, reason in skipped))
        print(f"  {len(skipped)} meshes skipped, see {path}")
    return landmarks, len(skipped)


def main(run: Run) -> dict:
    """Write the frames and one view of each."""
    model = face_model(run)
    rng = np.random.default_rng([run.seed, Stream.FRAMES])
    folder, skipped = run.folder_of("coma"), 0
    if folder is None:
        faces = make_performances(model, run.preset.frame_subjects, run.preset.frames, rng)
        landmarks = model.at_landmarks(run.scheme).shape(*faces)
        source = f"substitute, {model.name}"
    else:
        (landmarks, skipped), source = coma_frames(run, folder), "CoMA"
    cameras = sample_cameras(len(landmarks), rng, run.protocol)
    description = {"model": run.model, "scheme": run.scheme, "protocol": run.protocol}
    dataset = dataset_of(landmarks, cameras, description | {"frames": source})
    save_dataset(run.work / "train.npz", in_photos(run, dataset))
    return {
        "model": model.name,
        "model_sha256": model.sha256,
        "frames": source,
        "n_frames": len(landmarks),
        "skipped": skipped,
    }
