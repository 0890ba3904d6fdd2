"""The stages that the Makefile runs: what `python -m experiments STAGE` calls."""

from __future__ import annotations

# Stage to the module whose `main` it is.
STAGES = {
    "faces": "tracks.bfm.faces",
    "networks": "tracks.networks",
    "predictions": "tracks.predictions",
    "images": "tracks.bfm.images",
    "mobileface": "tracks.mobileface",
    "bfm": "tracks.bfm.bfm",
    "frames": "tracks.flame.frames",
    "scans": "tracks.flame.scans",
    "mediapipe": "tracks.flame.mediapipe",
    "rings": "tracks.flame.rings",
    "ringnet": "tracks.flame.ringnet",
    "flame": "tracks.flame.flame",
    "photos": "tracks.celeba.photos",
    "celeba": "tracks.celeba.celeba",
    "celeba_flame": "tracks.celeba.celeba_flame",
    "show": "tracks.show",
    "ablation": "studies.ablation",
    "seeds": "studies.seeds",
    "stream": "studies.stream",
    "pretrained": "studies.pretrained",
    "audit": "audit.audit",
    "bench": "bench.bench",
    "report": "report.report",
    "pictures": "figures.doc_pictures",
}
