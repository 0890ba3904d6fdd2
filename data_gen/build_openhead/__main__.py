"""Command line: `python -m data_gen.build_openhead` makes the embedded head model."""

import argparse
import sys
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from data_gen.build_openhead.components import align_rigidly, principal_components
from data_gen.build_openhead.cut import cut_head
from data_gen.build_openhead.makehuman import WHEEL, MakeHumanAssets, download_wheel
from data_gen.build_openhead.prior import sample_heads
from data_gen.models.openhead import OPENHEAD
from deepmds_keras.errors import InputError
from deepmds_keras.files import atomic_write

N_SAMPLES, SEED = 8000, 20240
NOSE_TIP = 28  # landmark 29 of bfm72
NOSE_TIP_POSITION = np.array([0.0, 4.4, 131.0])  # mm; where the Basel Face Model has it


def build(wheel: Path) -> dict[str, np.ndarray]:
    """The arrays of the asset, by name, from the wheel that carries MakeHuman's assets.

    Raises:
        InputError: A file is not what it should be.
    """
    assets = MakeHumanAssets(wheel)
    head = cut_head(assets)
    rng, progress = np.random.default_rng(SEED), partial(tqdm, desc="targets", unit="file")
    heads = sample_heads(assets, head, N_SAMPLES, rng, progress)
    mean = align_rigidly(heads, head, partial(tqdm, desc="alignment", unit="round"))
    identity = principal_components(heads, mean, head)
    # Left out: the head has no tongue, so nothing of it would move.
    expressions = [name for name in assets.face_unit_names() if name != "tongueOut"]
    moves = np.array([head.restrict(assets.face_unit(name)) for name in expressions])
    nose = mean[head.landmarks["bfm72"][NOSE_TIP]]
    return {
        "mean": (mean + NOSE_TIP_POSITION - nose).astype(np.float32),
        "identity_basis_times_sd": identity.astype(np.float16),
        "expression_basis": moves.astype(np.float16),
        "expression_names": np.array(expressions),
        "triangles": head.triangles.astype(np.uint16),
        "landmarks72": head.landmarks["bfm72"].astype(np.uint16),
        "landmarks68": head.landmarks["ibug68"].astype(np.uint16),
        "mirror": head.mirror.astype(np.uint16),
        "part": head.part.astype(np.uint8),
        "uv": head.uv.astype(np.float16),
        "base_vertex": head.base_vertex.astype(np.int16),
        **{f"mask_{k}": np.round(255 * mask).astype(np.uint8) for k, mask in head.masks.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m data_gen.build_openhead", description=__doc__)
    parser.add_argument("--wheel", type=Path, help=f"the wheel {WHEEL}; downloaded if not given")
    parser.add_argument("--output", type=Path, default=OPENHEAD, help="default: %(default)s")
    arguments = parser.parse_args()
    output = arguments.output
    with tempfile.TemporaryDirectory() as folder:
        try:
            wheel = arguments.wheel or download_wheel(WHEEL, Path(folder))
            # On one thread sums are taken in one order, so that the bytes can be repeated.
            with threadpool_limits(1):
                arrays = build(wheel)
        except InputError as error:
            sys.exit(f"error: {error}")
    with atomic_write(output) as file:
        np.savez_compressed(file, **arrays)
    print(f"{output}: {output.stat().st_size / 1e6:.2f} MB, {len(arrays['mean'])} vertices")


if __name__ == "__main__":
    main()
