"""`deepmds`, the command: 3D face landmarks of photos, or of landmarks that are given."""

from __future__ import annotations

from deepmds_keras.predict.command import main

if __name__ == "__main__":
    main()
