"""What schedulers cost: python experiments/schedulers.py WORK, as root of a machine with Debian's Slurm, or beside one.

The closed-form city, level 8, the same rays four times: in one process with a thread for each of two processors; in two
processes of one thread; in eight shards as tasks of Dask, on a cluster of two processes; in eight shards as an array of
Slurm's (tests/slurm/up). Merges are included, and so are starts: of Python, of the cluster, of every process. Writes
schedulers.md beside this file.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import dask
from dask.distributed import Client, LocalCluster

import octobayes as ob

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
PROGRAM = Path(os.environ.get("OCTOBAYES", ROOT / "target/release/octobayes"))
RAYS, LEVEL, SHARDS, OCCUPANCY = 4_096_000, 8, 8, 512
RUN = ["scene:city", "--level", str(LEVEL), "--rays", str(RAYS), "--occupancy", str(OCCUPANCY)]
# Appends its own processor times, user and system, and those of its children, when they have ended.
TIMED = '#!/bin/bash\n"$@"\ncode=$?\ntimes >> "$0.times"\nexit $code\n'


def cost(*commands: list[str]) -> tuple[float, float]:
    """Runs commands side by side: seconds by the wall, and of processors with all their children."""
    start, processor = time.monotonic(), 0.0
    running = [subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for command in commands]
    for process in running:
        _, status, used = os.wait4(process.pid, 0)
        assert status == 0, process.args
        processor += used.ru_utime + used.ru_stime
    return time.monotonic() - start, processor


def one(work: Path) -> tuple[float, float]:
    return cost([str(PROGRAM), "uncertainty", *RUN, "--threads", "2", "-o", str(work / "one.oct")])


def two(work: Path) -> tuple[float, float]:
    parts = [str(work / f"part{i}.oct") for i in range(2)]
    shard = [str(PROGRAM), "uncertainty", *RUN, "--threads", "1"]
    wall, processor = cost(*([*shard, "--shard", f"{i}/2", "-o", part] for i, part in enumerate(parts)))
    merge = cost([str(PROGRAM), "merge", *parts, "-o", str(work / "two.oct")])
    return wall + merge[0], processor + merge[1]


def on_dask(work: Path) -> tuple[float, float]:
    # Every process that Dask starts has one thread, as its worker has.
    os.environ["RAYON_NUM_THREADS"] = "1"
    found = cost([sys.executable, str(HERE / "schedulers.py"), "dask", str(work / "dask.oct")])
    del os.environ["RAYON_NUM_THREADS"]
    return found


def dask_client(output: str) -> None:
    """A program of its own, so that all its processes are counted."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        city = ob.open_model("scene:city")
        options = {"level": LEVEL, "rays": RAYS, "occupancy": OCCUPANCY}
        ob.uncertainty(city, executor=client.get_executor(), shards=SHARDS, **options).save(output)


def on_slurm(work: Path) -> tuple[float, float]:
    """The scripts of examples/slurm, with a program that also writes down what it took."""
    folder, scripts = work / "slurm", ROOT / "examples/slurm"
    up, down = (str(ROOT / "tests/slurm" / name) for name in ("up", "down"))
    timed = work / "timed"
    timed.write_text(TIMED)
    timed.chmod(0o755)
    subprocess.run([up, str(folder)], check=True)
    try:
        environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf"), "OCTOBAYES": f"{timed} {PROGRAM}"}

        def submit(*words: str) -> str:
            command = ["sbatch", "--parsable", "--cpus-per-task=1", "--mem=1G", *words]
            return subprocess.run(command, check=True, env=environment, cwd=work, capture_output=True, text=True).stdout

        start = time.monotonic()
        shard = [str(scripts / "shard.sbatch"), str(SHARDS), "parts", *RUN]
        array = submit(f"--array=0-{SHARDS - 1}", *shard).strip()
        merge = [str(scripts / "merge.sbatch"), str(SHARDS), "parts", "run.oct"]
        merge = submit(f"--dependency=afterany:{array}", *merge).strip()
        show = ["scontrol", "--oneliner", "show", "job", merge]
        state = "PENDING"
        while state in ("PENDING", "RUNNING", "COMPLETING"):
            time.sleep(0.2)
            shown = subprocess.run(show, check=True, env=environment, capture_output=True, text=True).stdout
            state = re.search(r"JobState=(\w+)", shown).group(1)
        wall = time.monotonic() - start
        assert state == "COMPLETED", state
    finally:
        subprocess.run([down, str(folder)], check=True)
    lines = (work / "timed.times").read_text().splitlines()
    # Every task once, and the merge: two lines each.
    assert len(lines) == 2 * (SHARDS + 1), lines
    minutes = re.findall(r"(\d+)m([\d.]+)s", "\n".join(lines))
    return wall, sum(60 * float(m) + float(s) for m, s in minutes)


WAYS = {
    "one process of two threads": one,
    "two processes of one thread, `merge`": two,
    "eight shards on Dask, two workers": on_dask,
    "eight shards on Slurm, two at a time": on_slurm,
}
TURNS = 2


def main() -> None:
    work = Path(sys.argv[1]).resolve()
    work.mkdir(parents=True, exist_ok=True)
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in WAYS}
    for turn in range(TURNS):
        for i, (name, way) in enumerate(WAYS.items()):
            # What an earlier, interrupted run has measured is not measured again.
            done = work / f"{turn}-{i}.json"
            if not done.exists():
                with tempfile.TemporaryDirectory() as folder:
                    done.write_text(json.dumps(way(Path(folder))))
            found[name].append(json.loads(done.read_text()))
            print(name, found[name][-1], flush=True)
    write(found)


def write(found: dict[str, list[tuple[float, float]]]) -> None:
    least = {name: [min(column) for column in zip(*times, strict=True)] for name, times in found.items()}
    first = least["one process of two threads"][1]
    rows = []
    for name, (wall, processor) in least.items():
        per_ray = 1e6 * processor / RAYS
        rows.append(f"| {name} | {wall:.1f} | {processor:.1f} | {per_ray:.2f} | {processor / first:.3f} |")
    slurm = subprocess.run(["/usr/sbin/slurmctld", "-V"], check=True, capture_output=True, text=True).stdout.strip()
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    table = "\n".join(rows)
    report = HERE / "schedulers.md"
    report.write_text(f"""# What schedulers cost

Written by `python experiments/schedulers.py WORK`, commit {commit.stdout.strip()}, Python {platform.python_version()},
Dask {dask.__version__}, {slurm}, two processors.

The closed-form city, level {LEVEL}, {RAYS:,} rays, seed 0, finite differences, occupancy {OCCUPANCY}. The least of
{TURNS} turns each, taken one after the other in turn. Processor times are of all processes, with the start of Python
and of the workers for Dask, and without Slurm's own for Slurm. The target is 1.10 times the first row.

| | by the wall, s | of processors, s | µs per ray | to the first |
|---|---:|---:|---:|---:|
{table}

By the wall, Slurm's own pace is included: it looks for work every two seconds here. What is added is a price per shard:
each prepares the scene anew, for 1.3 s of a processor (an occupancy grid of {OCCUPANCY}³ cells), writes its sums and is
merged; and the processes of Dask have to start Python.
""")


if __name__ == "__main__":
    if sys.argv[1] == "dask":
        dask_client(sys.argv[2])
    else:
        main()
