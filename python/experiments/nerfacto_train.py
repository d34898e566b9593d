"""Trains nerfacto on the fox photographs, on the CPU, for nerfacto.py.

    OCTOBAYES_DATA=... python experiments/nerfacto_train.py WORK [options of ns-train nerfacto]

Needs nerfstudio (Python 3.11). The photographs are copied to WORK/fox, a quarter as wide, because nerfstudio wants them
so; cameras are left as they are. The evaluation metric LPIPS, whose weights come from the internet, is replaced.
Nothing of the model is.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

#: Width and height of the photographs are divided by this.
DOWNSCALE = 4


def without_lpips() -> None:
    """Replaces LPIPS by a metric without weights, as the checkpoint must be read by the same classes."""
    import torch
    from torchmetrics.image import lpip

    class NoLpips(torch.nn.Module):
        def __init__(self, *_: object, **__: object) -> None:
            super().__init__()

        def forward(self, *_: object) -> torch.Tensor:
            return torch.tensor(float("nan"))

    lpip.LearnedPerceptualImagePatchSimilarity = NoLpips


def prepare(work: Path) -> Path:
    """The photographs that exist, smaller, and their cameras."""
    from PIL import Image

    source, folder = Path(os.environ["OCTOBAYES_DATA"]) / "fox", work / "fox"
    meta = json.loads((source / "transforms.json").read_text())
    meta["frames"] = [frame for frame in meta["frames"] if (source / frame["file_path"]).exists()]
    (folder / f"images_{DOWNSCALE}").mkdir(parents=True, exist_ok=True)
    for frame in meta["frames"]:
        name = Path(frame["file_path"]).name
        with Image.open(source / frame["file_path"]) as image:
            small = image.resize((image.width // DOWNSCALE, image.height // DOWNSCALE), Image.Resampling.BOX)
            small.save(folder / f"images_{DOWNSCALE}" / name, quality=95)
    (folder / "transforms.json").write_text(json.dumps(meta))
    return folder


def main() -> None:
    work, options = Path(sys.argv[1]), sys.argv[2:]
    without_lpips()
    from nerfstudio.scripts import train

    sys.argv = [
        "ns-train", "nerfacto", "--data", str(prepare(work)), "--output-dir", str(work / "outputs"), "--timestamp", "run",
        "--machine.device-type", "cpu", "--mixed-precision", "False", "--vis", "tensorboard",
        "--pipeline.model.implementation", "torch", "--pipeline.model.log2-hashmap-size", "15",
        "--pipeline.datamanager.train-num-rays-per-batch", "1024", "--steps-per-save", "200",
        "--steps-per-eval-image", "100000", "--steps-per-eval-batch", "100000", "--steps-per-eval-all-images", "100000",
        *options, "nerfstudio-data", "--downscale-factor", str(DOWNSCALE),
    ]  # fmt: skip
    train.entrypoint()


# Other processes of nerfstudio import this file.
if __name__ == "__main__":
    main()
