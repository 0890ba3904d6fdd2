"""Put the networks of `ours_stable` into the package as its default weights."""

from __future__ import annotations

from deepmds_keras.weights import PRETRAINED
from experiments.inputs import load_faces
from experiments.recipes import deep_mds
from experiments.run import parse_run, stage


def main(arguments: list[str] | None = None) -> None:
    run = parse_run(__doc__, arguments)
    with stage(run, "pretrained") as record:
        model, _ = deep_mds(run, load_faces(run, "train"), "ours_stable")
        path = PRETRAINED / f"{run.model}-{run.scheme}.npz"
        model.set_params(n_jobs=None).save(path)
        record["path"] = str(path)
        print(f"  {path}, {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
