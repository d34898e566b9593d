"""The command ``octobayes-nerfstudio``: uncertainty of a run of nerfstudio."""

from __future__ import annotations

import argparse
import sys

from . import _api, nerfstudio
from ._defaults import DEFAULT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="octobayes-nerfstudio",
        description="Computes where a model of nerfstudio can be trusted, from its checkpoint and training cameras. "
        "--load-config, --output-path, --lod and --iters mean what they mean in the plug-in of Bayes' Rays.",
        epilog="Only open runs of your own: nerfstudio executes what config.yml says.",
    )
    add = parser.add_argument
    add("--load-config", required=True, metavar="CONFIG", help="config.yml of the run; its latest checkpoint is read")
    add(
        "-o",
        "--output-path",
        default="field.oct",
        metavar="FILE",
        help="an .oct field, or an .npy grid of the plug-in [default: field.oct]",
    )
    add("--lod", "--level", type=int, default=8, metavar="N", help="2^N cells along each axis [default: 8]")
    rays = parser.add_mutually_exclusive_group()
    rays.add_argument("--iters", type=int, default=1000, metavar="N", help="batches of training rays [default: 1000]")
    rays.add_argument("--rays", type=int, metavar="N", help="number of rays, instead of batches of them")
    add(
        "--covariance",
        choices=["diagonal", "block", "trace"],
        help="[default: diagonal; trace, the plug-in's, for .npy]",
    )
    add(
        "--reach",
        type=float,
        default=4.0,
        metavar="R",
        help="of a contracted scene: half the edge of the cube in which rays are followed, scene units [default: 4]",
    )
    add("--march-step", type=float, metavar="S", help="distance between samples along a ray, scene units")
    add("--occupancy", type=int, default=DEFAULT.occupancy, metavar="N", help="cells per axis of the occupancy grid")
    add("--seed", type=int, default=0, metavar="N", help="seed of pixels and jitter [default: 0]")
    add("--no-pose-corrections", action="store_true", help="leave out what nerfstudio's camera optimiser learnt")
    return parser


def _run(options: argparse.Namespace) -> None:
    is_grid = options.output_path.endswith(".npy")
    if not is_grid and not options.output_path.endswith(".oct"):
        raise ValueError(f"--output-path: expected a name that ends in .oct or .npy, found {options.output_path}")
    field, cameras = nerfstudio.load(
        options.load_config,
        reach=options.reach,
        step=options.march_step,
        pose_corrections=not options.no_pose_corrections,
    )
    u = _api.uncertainty(
        field,
        cameras,
        level=options.lod,
        rays=options.rays or options.iters * field.rays_per_batch,
        covariance=options.covariance or ("trace" if is_grid else DEFAULT.covariance),
        keep_sums=is_grid,
        gradient="analytic",
        contract=field.contract,
        occupancy=options.occupancy,
        seed=options.seed,
    )
    if is_grid:
        _api.export(u, options.output_path)
    else:
        u.save(options.output_path)
    print(u)
    print(f"{options.output_path}: in scene units of the data parser, {field.scale:.6g} of which are an original unit")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; the result is the exit code."""
    options = _parser().parse_args(arguments)
    try:
        _run(options)
    except (ValueError, OSError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
