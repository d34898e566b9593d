//! Names that are no UTF-8, and paths that are no files.
#![cfg(target_os = "linux")]

use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

use octobayes::dataset::write_transforms;
use octobayes::field::ClosedForm;

/// Runs the program in a folder, with each `@` of the words replaced by a byte that begins no character.
fn run(folder: &Path, args: &str) -> Output {
    let word = |word: &str| {
        OsStr::from_bytes(&word.bytes().map(|b| if b == b'@' { 0xff } else { b }).collect::<Vec<_>>()).to_os_string()
    };
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    command.args(args.split_whitespace().map(word)).current_dir(folder).output().unwrap()
}

fn good(folder: &Path, args: &str) -> String {
    let output = run(folder, args);
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

const RUN: &str = "uncertainty scene:ball --level 4 --rays 600 --occupancy 16";

fn desk() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let cameras = ClosedForm::half_circle(3, [12, 12]).into_iter().enumerate();
    let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
    let odd = folder.path().join(OsStr::from_bytes(b"odd\xff"));
    std::fs::create_dir(&odd).unwrap();
    write_transforms(&folder.path().join("cameras.json"), &named).unwrap();
    write_transforms(&odd.join("cameras.json"), &named).unwrap();
    let mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n";
    std::fs::write(folder.path().join("mesh.obj"), mesh).unwrap();
    good(folder.path(), "synth mesh.obj -o set --count 2 --test-count 2 --resolution 32 --samples-per-pixel 1");
    good(folder.path(), &format!("{RUN} --cameras cameras.json --scale data --noise 0.1 --keep-sums -o field.oct"));
    folder
}

/// Every verb writes files of any name, and says in its JSON what they are called, as well as that can be said.
#[test]
fn names_that_are_no_utf_8_are_read_and_written() {
    let folder = desk();
    let folder = folder.path();
    let train = "train set -o odd@/m@.safetensors --steps 2 --log2-hashmap-size 8 --samples-per-step 1024";
    let judged = "--cameras set/transforms_test.json --depth set/depth --depth-pattern {}.exr";
    let all = [
        (format!("{RUN} --cameras odd@/cameras.json -o odd@/f@.oct --json"), "odd@/f@.oct"),
        ("export odd@/f@.oct -o odd@/c@.oct".into(), "odd@/c@.oct"),
        ("info odd@/f@.oct --json".into(), ""),
        ("compare odd@/f@.oct odd@/c@.oct --points 10 --json".into(), ""),
        ("query odd@/f@.oct 0,0,0 -o odd@/a@.csv".into(), "odd@/a@.csv"),
        ("render scene:ball odd@/f@.oct --cameras odd@/cameras.json -o odd@/r@.png".into(), "odd@/r@.png"),
        ("view scene:ball odd@/f@.oct --cameras cameras.json --cells 32 -o odd@/v@.html".into(), "odd@/v@.html"),
        ("export scene:ball odd@/f@.oct --cameras cameras.json --pixels 100 -o odd@/e@.csv".into(), "odd@/e@.csv"),
        (format!("evaluate scene:ball field.oct {judged} --calibrate odd@/k@.oct --json"), "odd@/k@.oct"),
        (
            "evaluate scene:ball field.oct --cameras set/transforms_test.json --clean-up odd@/s@.png --json".into(),
            "odd@/s@.png",
        ),
        (format!("{train} --json"), "odd@/m@.safetensors"),
        (format!("{train} --members 2"), "odd@/m@-1.safetensors"),
        ("synth mesh.obj -o odd@/set@ --count 1 --test-count 1 --resolution 8".into(), "odd@/set@"),
        ("completions man -o odd@/man@".into(), "odd@/man@"),
    ];
    for (args, written) in all {
        let said = good(folder, &args);
        let name: Vec<u8> = written.bytes().map(|b| if b == b'@' { 0xff } else { b }).collect();
        assert!(folder.join(OsStr::from_bytes(&name)).exists(), "{args}: {said}");
    }
}

/// The name of a model stands in fields, so that it has to be text.
#[test]
fn models_whose_names_are_no_utf_8_are_refused_by_name() {
    let folder = desk();
    let rays = "--cameras cameras.json";
    for args in [
        format!("uncertainty m@.npz {rays} -o x.oct"),
        format!("render m@.npz field.oct {rays} -o x.png"),
        format!("export m@.npz field.oct {rays} -o x.ply"),
        "query field.oct --ray 0,0,0,0,0,1 --model m@.npz".into(),
        "info m@.npz".into(),
        "demo --scene ball --output odd@/demo".into(),
    ] {
        let output = run(folder.path(), &args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args}: {said}");
        assert!(said.contains("a path in UTF-8") && !said.contains("panicked"), "{args}: {said}");
    }
}

/// A pipe that nobody writes to keeps its reader waiting for ever.
#[test]
fn pipes_are_refused_at_once_where_files_are_read() {
    let folder = desk();
    let folder = folder.path();
    let pipes = ["p.json", "p.npz", "p.safetensors", "p.ppng", "p.ckpt", "p.oct", "p.npy", "p.obj", "p.exr"];
    for pipe in pipes {
        assert!(Command::new("mkfifo").arg(folder.join(pipe)).status().unwrap().success());
    }
    for (args, pipe) in [
        (format!("{RUN} --cameras p.json -o x.oct"), "p.json"),
        ("train p.json -o x.safetensors --steps 2".into(), "p.json"),
        ("render scene:ball p.oct --cameras cameras.json -o x.png".into(), "p.oct"),
        ("query p.oct 0,0,0".into(), "p.oct"),
        ("query field.oct p.npy".into(), "p.npy"),
        ("info p.oct".into(), "p.oct"),
        ("export p.npy -o x.oct --box=-1,-1,-1,1,1,1".into(), "p.npy"),
        ("uncertainty p.npz --box=-1,-1,-1,1,1,1 -o x.oct".into(), "p.npz"),
        ("merge field.oct p.oct -o x.oct".into(), "p.oct"),
        ("synth p.obj -o x".into(), "p.obj"),
        ("info p.safetensors".into(), "p.safetensors"),
        ("info p.npz".into(), "p.npz"),
        ("info p.ppng".into(), "p.ppng"),
        ("info p.ckpt".into(), "p.ckpt"),
    ] {
        let args: Vec<&str> = args.split_whitespace().collect();
        let mut command = Command::new("timeout");
        let start = Instant::now();
        let output =
            command.args(["60", env!("CARGO_BIN_EXE_octobayes")]).args(&args).current_dir(folder).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
        assert!(said.contains(pipe) && said.contains("input path: expected a file"), "{args:?}: {said}");
        assert!(start.elapsed() < Duration::from_secs(50), "{args:?} waited");
    }
}

/// `query` reads points from a pipe as they come, and ends at once when it is asked to, as for stdin.
#[test]
fn points_may_come_through_a_pipe_and_waiting_for_them_ends_on_request() {
    let folder = desk();
    let folder = folder.path();
    assert!(Command::new("mkfifo").arg(folder.join("p.csv")).status().unwrap().success());
    let script = format!("{} query field.oct p.csv & echo 0,0,0 > p.csv; wait $!", env!("CARGO_BIN_EXE_octobayes"));
    let output = Command::new("sh").args(["-c", &script]).current_dir(folder).output().unwrap();
    assert!(output.status.success() && output.stdout.starts_with(b"x,y,z,"), "{output:?}");
    let mut command = Command::new(env!("CARGO_BIN_EXE_octobayes"));
    let mut child = command.args(["query", "field.oct", "p.csv"]).current_dir(folder).spawn().unwrap();
    // Opens when the program has opened its end, and keeps it waiting.
    let _pipe = std::fs::OpenOptions::new().write(true).open(folder.join("p.csv")).unwrap();
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > Duration::from_secs(30) {
            child.kill().unwrap();
            panic!("it ignores SIGTERM");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}
