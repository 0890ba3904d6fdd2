"""Step: train one method, resuming from its checkpoint."""

from experiments.inputs import IMAGE_STEPS, TRAINING_IMAGES
from experiments.method import Method
from experiments.methods import method_of, train
from experiments.records import read_record, resumable
from experiments.run import Run


def limit_threads(threads: int | None) -> None:
    """Set TensorFlow's threads, if not None: the order of sums depends on their number."""
    if threads is None:
        return
    import tensorflow as tf

    tf.config.threading.set_intra_op_parallelism_threads(threads)
    tf.config.threading.set_inter_op_parallelism_threads(threads)


def keep_checkpoints(run: Run, method: Method) -> None:
    """Delete checkpoints of trainings on faces or images other than the run's.

    Methods that see views have one folder, since some share a network.
    """
    if not method.sees_images:
        resumable(run.networks, [run.work / "train.npz"])
        return
    part = TRAINING_IMAGES[run.track]
    images = read_record(run.record_file(IMAGE_STEPS[run.track, part]))["checksums"][part]
    folder = method.checkpoint(run).parent
    resumable(folder, [run.work / "landmark_model.npz"], images=images)


def main(run: Run, method_id: str) -> dict:
    method = method_of(method_id)
    limit_threads(method.threads)
    keep_checkpoints(run, method)
    train(run, method_id)
    return {"method": method_id}
