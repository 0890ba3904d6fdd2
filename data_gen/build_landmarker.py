"""Command line: `python -m data_gen.build_landmarker` makes the face landmarker of MediaPipe's.

MediaPipe 0.10.21 is the last whose wheel holds models of faces: a detector, and FaceMesh without
irises. Later releases take a bundle of two such models, described by metadata. This makes the one
from the other. Nothing of the old wheel is imported or run; the file's formats are those of the
MediaPipe that is installed.
"""

import argparse
import sys
import tempfile
import zipfile
from pathlib import Path

import flatbuffers
import numpy as np
from mediapipe.tasks.metadata import metadata_schema_py_generated as metadata
from mediapipe.tasks.metadata import schema_py_generated as tflite

from data_gen.build_openhead.makehuman import download_wheel
from deepmds_keras.errors import InputError
from deepmds_keras.files import atomic_write

WHEEL = "mediapipe==0.10.21"
OUTPUT = Path(__file__).parents[1] / "deepmds_keras/tool/detection/face_landmarker.task"
_MODULES = "mediapipe/modules/"
_DETECTOR = _MODULES + "face_detection/face_detection_short_range.tflite"
_MESH = _MODULES + "face_landmark/face_landmark.tflite"
_N_POINTS = 468
# A bundle must give 478 points, the last ten on the irises, which this model lacks. They are
# repeated from the eyelids: the box in which the next frame of a video is searched is drawn around
# all points, so that zeros would move it.
_EYELIDS = (33, 160, 158, 133, 153, 362, 385, 387, 263, 373)
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the first date that a zip can hold


def build(wheel: Path) -> dict[str, bytes]:
    """The files of the bundle, by name.

    Raises:
        InputError: Not that wheel.
    """
    try:
        with zipfile.ZipFile(wheel) as files:
            detector, mesh = (
                tflite.ModelT.InitFromObj(tflite.Model.GetRootAs(files.read(name), 0))
                for name in (_DETECTOR, _MESH)
            )
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{wheel} must be the wheel {WHEEL}. Received: {error}.") from None
    _repeat_eyelids(mesh)
    return {
        # From 0 to 255, pixels become -1 to 1 for the detector, and 0 to 1 for the mesh.
        "face_detector.tflite": _described(detector, 127.5, 127.5),
        "face_landmarks_detector.tflite": _described(mesh, 0.0, 255.0),
    }


def _repeat_eyelids(model: tflite.ModelT) -> None:
    """Let one more operator, GATHER, append the ten points to the first output."""
    graph = model.subgraphs[0]
    points = np.r_[np.arange(_N_POINTS), _EYELIDS]
    numbers = (3 * points[:, None] + np.arange(3)).ravel().astype("<i4")

    def add_tensor(name: bytes, shape: list[int], kind: int, content: bytes | None = None) -> int:
        buffer = tflite.BufferT()
        buffer.data = None if content is None else np.frombuffer(content, np.uint8)
        model.buffers.append(buffer)
        tensor = tflite.TensorT()
        tensor.name, tensor.type, tensor.buffer = name, kind, len(model.buffers) - 1
        tensor.shape = np.array(shape, np.int32)
        graph.tensors.append(tensor)
        return len(graph.tensors) - 1

    picked = add_tensor(b"picked", [len(numbers)], tflite.TensorType.INT32, numbers.tobytes())
    output = add_tensor(b"points_478", [1, 1, 1, len(numbers)], tflite.TensorType.FLOAT32)
    code = tflite.OperatorCodeT()
    code.builtinCode = code.deprecatedBuiltinCode = tflite.BuiltinOperator.GATHER
    code.version = 1
    model.operatorCodes.append(code)
    gather = tflite.OperatorT()
    gather.opcodeIndex = len(model.operatorCodes) - 1
    gather.inputs = np.array([graph.outputs[0], picked], np.int32)
    gather.outputs = np.array([output], np.int32)
    gather.builtinOptionsType = tflite.BuiltinOptions.GatherOptions
    gather.builtinOptions = tflite.GatherOptionsT()
    gather.builtinOptions.axis = 3
    graph.operators.append(gather)
    graph.outputs = np.array([output, *graph.outputs[1:]], np.int32)


def _described(model: tflite.ModelT, mean: float, sd: float) -> bytes:
    """The model's file, with metadata that say how its input, an RGB image, is scaled."""
    scaling = metadata.ProcessUnitT()
    scaling.optionsType = metadata.ProcessUnitOptions.NormalizationOptions
    scaling.options = metadata.NormalizationOptionsT()
    scaling.options.mean, scaling.options.std = [mean], [sd]
    image = metadata.TensorMetadataT()
    image.name, image.processUnits = "image", [scaling]
    image.content = metadata.ContentT()
    image.content.contentPropertiesType = metadata.ContentProperties.ImageProperties
    image.content.contentProperties = metadata.ImagePropertiesT()
    image.content.contentProperties.colorSpace = metadata.ColorSpaceType.RGB
    graph = metadata.SubGraphMetadataT()
    graph.inputTensorMetadata = [image]
    description = metadata.ModelMetadataT()
    description.subgraphMetadata, description.minParserVersion = [graph], "1.0.0"
    entry = tflite.MetadataT()
    entry.name, entry.buffer = b"TFLITE_METADATA", len(model.buffers)
    buffer = tflite.BufferT()
    buffer.data = np.frombuffer(_packed(description, b"M001"), np.uint8)
    model.buffers.append(buffer)
    model.metadata = [*(model.metadata or ()), entry]
    return _packed(model, b"TFL3")


def _packed(table, identifier: bytes) -> bytes:
    builder = flatbuffers.Builder(1 << 21)
    builder.Finish(table.Pack(builder), identifier)
    return bytes(builder.Output())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m data_gen.build_landmarker")
    parser.add_argument("--wheel", type=Path, help=f"the wheel {WHEEL}; downloaded if not given")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        try:
            models = build(arguments.wheel or download_wheel(WHEEL, Path(folder)))
        except InputError as error:
            sys.exit(f"error: {error}")
    # Stored, not compressed: MediaPipe reads no other.
    with atomic_write(OUTPUT) as file, zipfile.ZipFile(file, "w") as bundle:
        for name, content in models.items():
            bundle.writestr(zipfile.ZipInfo(name, _EPOCH), content)
    print(f"{OUTPUT}: {OUTPUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
