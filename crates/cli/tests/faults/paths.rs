//! Names that are no UTF-8, and paths that are no files.
#![cfg(target_os = "linux")]

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::program::{Desk, TETRAHEDRON, cameras};
use octobayes_data::write_transforms;

/// A word with each `@` replaced by a byte that begins no character.
fn odd(word: &str) -> OsString {
    OsStr::from_bytes(&word.bytes().map(|b| if b == b'@' { 0xff } else { b }).collect::<Vec<_>>()).to_os_string()
}

/// Exit code and stderr of the program with odd words.
fn run(desk: &Desk, args: &str) -> (Option<i32>, String) {
    let output = desk.command("").args(args.split_whitespace().map(odd)).output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

const RUN: &str = "uncertainty scene:ball --level 4 --rays 600 --occupancy 16";

fn desk() -> Desk {
    let desk = Desk::new(3, 12);
    std::fs::create_dir(desk.join(odd("odd@"))).unwrap();
    write_transforms(&desk.join(odd("odd@")).join("cameras.json"), &cameras(3, [12; 2])).unwrap();
    desk.write("mesh.obj", TETRAHEDRON);
    desk.good("synth mesh.obj -o set --count 2 --test-count 2 --resolution 32 --samples-per-pixel 1");
    desk.good(&format!("{RUN} --cameras cameras.json --scale data --noise 0.1 --keep-sums -o field.oct"));
    desk
}

/// Every verb writes files of any name, and says in its JSON what they are called, as well as that can be said.
#[test]
fn names_that_are_no_utf_8_are_read_and_written() {
    let desk = desk();
    let train = "train set -o odd@/m@.safetensors --steps 2 --log2-hashmap-size 8 --samples-per-step 1024 --members 2";
    let judged = "evaluate scene:ball field.oct --cameras set/transforms_test.json";
    for (args, written) in [
        (format!("{RUN} --cameras odd@/cameras.json -o odd@/f@.oct --json"), "odd@/f@.oct"),
        ("export odd@/f@.oct -o odd@/c@.oct".into(), "odd@/c@.oct"),
        ("compare odd@/f@.oct odd@/c@.oct --points 10 --json".into(), ""),
        ("query odd@/f@.oct 0,0,0 -o odd@/a@.csv".into(), "odd@/a@.csv"),
        ("render scene:ball odd@/f@.oct --cameras odd@/cameras.json -o odd@/r@.png".into(), "odd@/r@.png"),
        ("view scene:ball odd@/f@.oct --cameras cameras.json --cells 32 -o odd@/v@.html".into(), "odd@/v@.html"),
        (format!("{judged} --depth set/depth --depth-pattern {{}}.exr --calibrate odd@/k@.oct --json"), "odd@/k@.oct"),
        (format!("{judged} --clean-up odd@/s@.png --json"), "odd@/s@.png"),
        (format!("{train} --json"), "odd@/m@-1.safetensors"),
        ("synth mesh.obj -o odd@/set@ --count 1 --test-count 1 --resolution 8".into(), "odd@/set@"),
        ("completions man -o odd@/man@".into(), "odd@/man@"),
    ] {
        let (code, said) = run(&desk, &args);
        assert!(code == Some(0) && desk.join(odd(written)).exists(), "{args}: {said}");
    }
}

/// The name of a model stands in fields, so that it has to be text.
#[test]
fn models_whose_names_are_no_utf_8_are_refused_by_name() {
    let desk = desk();
    for args in [
        "uncertainty m@.npz --cameras cameras.json -o x.oct",
        "render m@.npz field.oct --cameras cameras.json -o x.png",
        "query field.oct --ray 0,0,0,0,0,1 --model m@.npz",
        "demo --scene ball --output odd@/demo",
    ] {
        let (code, said) = run(&desk, args);
        assert!(code == Some(2) && said.contains("UTF-8") && !said.contains("panicked"), "{args}: {said}");
    }
}

/// A pipe that nobody writes to keeps its reader waiting for ever.
#[test]
fn pipes_are_refused_at_once_where_files_are_read() {
    let desk = desk();
    for (args, pipe) in [
        (&*format!("{RUN} --cameras p.json -o x.oct"), "p.json"),
        ("render scene:ball p.oct --cameras cameras.json -o x.png", "p.oct"),
        ("query field.oct p.npy", "p.npy"),
        ("export p.npy -o x.oct --box=-1,-1,-1,1,1,1", "p.npy"),
        ("uncertainty p.npz --box=-1,-1,-1,1,1,1 -o x.oct", "p.npz"),
        ("synth p.obj -o x", "p.obj"),
        ("info p.safetensors", "p.safetensors"),
        ("info p.npz", "p.npz"),
        ("info p.ppng", "p.ppng"),
        ("info p.ckpt", "p.ckpt"),
    ] {
        let path = desk.join(pipe);
        assert!(path.exists() || Command::new("mkfifo").arg(path).status().unwrap().success());
        let start = Instant::now();
        let mut command = Command::new("timeout");
        let program = command.args(["60", env!("CARGO_BIN_EXE_octobayes")]).args(args.split_whitespace());
        let output = program.current_dir(&*desk).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(pipe), "{args}: {said}");
        assert!(said.contains("a device or a pipe") && start.elapsed() < Duration::from_secs(50), "{args}: {said}");
    }
}

/// `query` reads points from a pipe as they come, and ends at once when it is asked to, as for stdin.
#[test]
fn points_may_come_through_a_pipe_and_waiting_for_them_ends_on_request() {
    let desk = desk();
    assert!(Command::new("mkfifo").arg(desk.join("p.csv")).status().unwrap().success());
    let started = || {
        let child = desk.command("query field.oct p.csv").stdout(Stdio::piped()).spawn().unwrap();
        // Opens when the program has opened its end.
        (child, std::fs::OpenOptions::new().write(true).open(desk.join("p.csv")).unwrap())
    };
    let (child, mut pipe) = started();
    std::io::Write::write_all(&mut pipe, b"0,0,0\n").unwrap();
    drop(pipe);
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stdout.starts_with(b"x,y,z,"), "{output:?}");
    let (mut child, _pipe) = started();
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
