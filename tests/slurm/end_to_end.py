"""examples/slurm with a real Slurm: tests/slurm/end_to_end.py FOLDER.

Needs SLURM_CONF (tests/slurm/up) and OCTOBAYES, the program. One array task is killed by Slurm and requeued by hand,
one loses its process to kill -9, one runs out of time: the merged field is that of a single run. Then a part is taken
away, and one is replaced by that of another run.
"""

from __future__ import annotations

import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

PROGRAM = os.environ["OCTOBAYES"]
SCRIPTS = Path(__file__).resolve().parents[2] / "examples/slurm"
SHARDS = 6
# What the node has room for twice. The scripts ask for more.
REQUESTS = ["--cpus-per-task=1", "--mem=512M", "--time=5"]
# A shard takes some seconds, so that there is time to kill it.
RUN = ["scene:courtyard", "--level", "7", "--rays", "600k", "--resolution", "200", "--occupancy", "64"]
# Decades of log10 U. The shards' sums are the single run's in another order: n positive f64 terms, n < 600,000, differ
# by a relative n 2^-53 < 1e-10. U is rounded to f32, so stored values differ by one unit in the last place or not at
# all: 2^-23 / ln 10 = 5e-8 decades. Interpolation between vertices, in f32, may add a few such units.
TOLERANCE = 3e-7
PATIENCE = 120.0

began = time.monotonic()


def say(text: str) -> None:
    print(f"{time.monotonic() - began:6.1f} s  {text}", flush=True)


def run(*words: str, cwd: Path) -> str:
    """Runs a command that must succeed; what it prints."""
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, f"{shlex.join(words)}: {done.stdout}{done.stderr}"
    return done.stdout


class Cluster:
    """Slurm, asked by its own commands."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def submit(self) -> tuple[str, str]:
        """Submits both scripts; the array's and the merge's job."""
        shard = [str(SCRIPTS / "shard.sbatch"), str(SHARDS), "parts", *RUN]
        submit = ["sbatch", "--parsable", *REQUESTS]
        array = run(*submit, f"--array=0-{SHARDS - 1}", "--output=%a.log", *shard, cwd=self.folder).strip()
        return array, self.merge(f"--dependency=afterany:{array}", "--output=merge.log")

    def merge(self, *options: str) -> str:
        """Submits the merge alone; its job."""
        script = [str(SCRIPTS / "merge.sbatch"), str(SHARDS), "parts", "run.oct"]
        return run("sbatch", "--parsable", *REQUESTS, *options, *script, cwd=self.folder).strip()

    def job(self, job: str) -> dict[str, str]:
        shown = run("scontrol", "--oneliner", "show", "job", job, cwd=self.folder)
        return dict(pair.split("=", 1) for pair in shown.split() if "=" in pair)

    def state(self, job: str) -> str:
        return self.job(job)["JobState"]

    def update(self, job: str, *changes: str) -> None:
        run("scontrol", "update", f"JobId={job}", *changes, cwd=self.folder)

    def wait(self, what: str, holds: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, f"in vain: {what}\n{run('squeue', '--states=all', cwd=self.folder)}"
            time.sleep(0.1)
        say(what)

    def wait_until_queued_again(self, job: str) -> None:
        """Slurm lets a requeued job wait for two minutes; here, three seconds do. Not less: a node starts no job that
        it killed in the same second."""
        self.wait(f"{job} queues again", lambda: self.job(job)["Restarts"] == "1" and self.state(job) == "PENDING")
        self.update(job, "StartTime=now+3", "TimeLimit=5")

    def ended(self, job: str) -> str:
        """Waits for a job's end; its state."""
        over = ("COMPLETED", "FAILED", "CANCELLED", "TIMEOUT", "NODE_FAIL", "OUT_OF_MEMORY")
        self.wait(f"{job} has ended", lambda: self.state(job) in over)
        return self.state(job)


def process_of(array: str, task: int) -> int | None:
    """The process of octobayes that computes a task, if there is one."""
    wanted = {f"SLURM_ARRAY_JOB_ID={array}", f"SLURM_ARRAY_TASK_ID={task}"}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if (folder / "comm").read_text().strip() == Path(PROGRAM).name[:15]:
                if wanted <= set((folder / "environ").read_text().split("\0")):
                    return int(folder.name)
        except (OSError, UnicodeDecodeError):
            pass  # It has ended meanwhile.
    return None


def processor_seconds(process: int) -> float:
    """What a process has used: fields 14 and 15 of its stat, counted behind the name (field 2) in parentheses."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measured(*words: str, cwd: Path) -> tuple[str, float]:
    """Runs a command that must succeed; what it prints, and its processor seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    printed = run(*words, cwd=cwd)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return printed, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    folder = Path(sys.argv[1], "a run")
    folder.mkdir(parents=True)
    cluster = Cluster(folder)
    _, single = measured(PROGRAM, "uncertainty", *RUN, "-o", "single.oct", cwd=folder)
    shard = ["--shard", f"0/{SHARDS}", "--dry-run", "--json"]
    printed, before_rays = measured(PROGRAM, "uncertainty", *RUN, *shard, cwd=folder)
    say(f"the single run took {single:.1f} processor seconds, {before_rays:.1f} of them before its rays")
    needs = json.loads(printed)
    say(f"a shard needs {needs['peak_bytes'] / 1e6:.0f} MB")
    assert needs["peak_bytes"] < 512e6, "what REQUESTS asks for"
    # Processor time, because beside other work a process may have got next to none in any number of seconds.
    under_way = before_rays + (single - before_rays) / SHARDS / 3
    parts = folder / "parts"
    part = [parts / f"{i}.oct" for i in range(SHARDS)]

    # Tasks 0 and 1 run side by side, then 2 and 3.
    array, merge = cluster.submit()
    say(f"submitted {array} and {merge}")
    cluster.wait("tasks 0 and 1 compute", lambda: all(process_of(array, i) for i in (0, 1)))
    os.kill(process_of(array, 1), signal.SIGKILL)
    run("scancel", "--signal=KILL", f"{array}_0", cwd=folder)
    cluster.wait("Slurm has killed task 0", lambda: cluster.state(f"{array}_0") == "CANCELLED")
    run("scontrol", "requeue", f"{array}_0", cwd=folder)
    for task in (0, 1):
        cluster.wait_until_queued_again(f"{array}_{task}")
    assert not part[0].exists() and not part[1].exists(), "they were killed under way"
    cluster.wait("task 2 computes", lambda: process_of(array, 2))
    task = process_of(array, 2)
    cluster.wait("task 2 has drawn a third of its rays", lambda: processor_seconds(task) > under_way)
    # Slurm looks at the time every half minute; until then the process stands still. SIGCONT comes with SIGTERM.
    os.kill(task, signal.SIGSTOP)
    cluster.update(f"{array}_2", "TimeLimit=1")
    cluster.wait_until_queued_again(f"{array}_2")
    assert "rays; the same command goes on" in (folder / "2.log").read_text(), "it saved its state"

    assert cluster.ended(merge) == "COMPLETED", (folder / "merge.log").read_text()
    for task in range(SHARDS):
        job = cluster.job(f"{array}_{task}")
        assert job["JobState"] == "COMPLETED" and job["Restarts"] == str(int(task < 3)), job
    assert not list(parts.glob("*.chk")), "checkpoints are gone"
    compared = json.loads(run(PROGRAM, "compare", "run.oct", "single.oct", "--json", cwd=folder))
    for where in ("in_box", "on_surfaces"):
        difference = compared[where]
        say(f"{where}: {difference['max']:.2e} decades at most, {difference['mean']:.2e} in the mean")
        assert difference["max"] <= TOLERANCE and difference["points"] > 10_000
    ray_sets = [record["ray_sets"] for record in compared["records"]]
    assert ray_sets[0] == ray_sets[1], "the same rays"
    merged = (folder / "run.oct").read_bytes()
    say(f"the same bytes: {merged == (folder / 'single.oct').read_bytes()}")

    # A part is taken away: the merge, submitted by itself, names it.
    before = {path: path.stat().st_mtime_ns for path in part}
    part[3].unlink()

    def refused(log: str) -> str:
        job = cluster.merge(f"--output={log}")
        assert cluster.ended(job) == "FAILED"
        return (folder / log).read_text()

    said = refused("missing.log")
    assert "parts/3.oct: cannot open" in said, said
    # Submitted again, the script computes that part and no other, and the merged field is the same.
    array, merge = cluster.submit()
    assert cluster.ended(merge) == "COMPLETED", (folder / "merge.log").read_text()
    again = [path for path in part if path.stat().st_mtime_ns != before[path]]
    assert again == [part[3]], again
    skipped = [i for i in range(SHARDS) if "is complete: nothing to do" in (folder / f"{i}.log").read_text()]
    assert skipped == [0, 1, 2, 4, 5], skipped
    assert (folder / "run.oct").read_bytes() == merged, "the same parts, the same bytes"
    say("a part that was taken away was named and, when submitted again, computed; no other")

    # A part of another run.
    other = [*RUN, "--lambda", "1", "--shard", f"4/{SHARDS}"]
    run(PROGRAM, "uncertainty", *other, "-o", str(part[4]), cwd=folder)
    said = refused("other.log")
    assert "lambda of parts/4.oct: expected " in said, said
    say("a part of another run was named")


main()
