"""Trains nerfacto on the CPU, on lego or on the fox photographs, for nerfacto.py.

    OCTOBAYES_DATA=... python experiments/nerfacto_train.py WORK lego|fox [options of ns-train nerfacto]

Needs nerfstudio (Python 3.11). The data set is put into WORK as nerfstudio wants it: the photographs a quarter as wide,
with their cameras as they are. The evaluation metric LPIPS, whose weights come from the internet, is replaced. Of the
model only sizes differ: 2^15 entries in the hash tables, 128 and 48 samples to propose where a ray is dense.
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


def fox(work: Path) -> Path:
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


def lego(work: Path) -> Path:
    """The pictures, and a list of validation views, which the parser wants and does not use here."""
    source, folder = Path(os.environ["OCTOBAYES_DATA"]) / "nerf-lego-400", work / "lego"
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("train", "test"):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(source / name, target_is_directory=True)
    for name, of in (("train", "train"), ("test", "test"), ("val", "test")):
        (folder / f"transforms_{name}.json").write_text((source / f"transforms_{of}.json").read_text())
    return folder


#: For each scene: how its folder is made, options of the model, and the data parser with its options. Those of lego are
#: the ones that nerfstudio's documentation recommends for synthetic scenes.
SCENES = {
    "fox": (fox, [], ["nerfstudio-data", "--downscale-factor", str(DOWNSCALE)]),
    "lego": (
        lego,
        [
            "--pipeline.model.background-color", "white", "--pipeline.model.proposal-initial-sampler", "uniform",
            "--pipeline.model.near-plane", "2", "--pipeline.model.far-plane", "6",
            "--pipeline.model.camera-optimizer.mode", "off", "--pipeline.model.distortion-loss-mult", "0",
            "--pipeline.model.use-average-appearance-embedding", "False",
            "--pipeline.model.disable-scene-contraction", "True",
        ],
        ["blender-data"],
    ),
}  # fmt: skip


def main() -> None:
    work, scene, options = Path(sys.argv[1]), sys.argv[2], sys.argv[3:]
    prepare, of_model, of_data = SCENES[scene]
    without_lpips()
    from nerfstudio.scripts import train

    sys.argv = [
        "ns-train", "nerfacto", "--data", str(prepare(work)), "--output-dir", str(work / "outputs"),
        "--timestamp", "run",
        "--machine.device-type", "cpu", "--mixed-precision", "False", "--vis", "tensorboard",
        "--pipeline.model.implementation", "torch", "--pipeline.model.log2-hashmap-size", "15",
        "--pipeline.model.num-proposal-samples-per-ray", "128", "48",
        "--pipeline.datamanager.train-num-rays-per-batch", "512", "--steps-per-save", "100",
        "--steps-per-eval-image", "100000", "--steps-per-eval-batch", "100000", "--steps-per-eval-all-images", "100000",
        *of_model, *options, *of_data,
    ]  # fmt: skip
    train.entrypoint()


# Other processes of nerfstudio import this file.
if __name__ == "__main__":
    main()
