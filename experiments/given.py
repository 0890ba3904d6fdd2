"""Checks of the files and folders that the variables of `make` name, before any work."""

from pathlib import Path

from data_gen.models.registry import model_files
from deepmds_keras.errors import InputError
from experiments.run import AUTHORS_FILES, Run

# Readers are imported by need: the variables of a plain run name nothing.


def check_given(run: Run) -> None:
    """Check that what a run was given holds what its track reads of it.

    Raises:
        InputError: Something does not; the message names the variable, or the folder, and what it
            must hold.
    """
    for name in AUTHORS_FILES[run.track] if run.authors else ():
        if not Path(run.authors, name).is_file():
            raise InputError(f"AUTHORS must be a folder with {name}. Received {run.authors}.")
    if run.ringnet and not Path(f"{run.ringnet}.index").is_file():
        raise InputError(
            "RINGNET must be yes, no or the path of the licensed checkpoint without suffix, such "
            f"as ring_6_68641. Received {run.ringnet}."
        )
    if run.ringnet:
        try:
            model_files("flame", run.data)
        except InputError as error:
            raise InputError(f"RINGNET has its landmarks on FLAME's mesh: {error}") from None
    if run.objects:
        from experiments.objects.shapes import OBJECTS, object_file

        for name in OBJECTS:
            if not object_file(run.objects, name).is_file():
                raise InputError(
                    f"OBJECTS must be a folder with {name}.npz. Received {run.objects}."
                )
    if run.sfm:
        from deepmds_keras.baselines.eos_fit import surrey_files

        surrey_files(run.sfm)
    if run.track == "flame":
        _check_meshes_and_scans(run)
    if run.track == "celeba" and run.celeba:
        from data_gen.datasets.celeba import find_images

        find_images(run.celeba)
    if run.track != "bfm" and run.tf_flame:
        from experiments.tracks.celeba_flame import read_folder

        read_folder(Path(run.tf_flame))


def _check_meshes_and_scans(run: Run) -> None:
    meshes, scans = run.folder_of("coma"), run.folder_of("casia")
    if meshes:
        from data_gen.datasets.coma import find_meshes
        from experiments.inputs import embedding_file

        find_meshes(meshes)
        embedding_file(run)
    if scans:
        from data_gen.datasets import casia

        found = casia.find_scans(scans, report=lambda sentence: None)
        if run.casia_index:
            casia.read_index(run.casia_index, found)
