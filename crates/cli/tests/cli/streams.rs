//! stdout and stderr that nobody can take: what the program has to say is lost, its work is not.
#![cfg(target_os = "linux")]

use std::fs::OpenOptions;
use std::path::Path;
use std::process::{Output, Stdio};

use crate::program::{Desk, TETRAHEDRON, command};

/// Where a stream of the program leads.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sink {
    /// To the test.
    Here,
    /// To a pipe whose reader has gone.
    Gone,
    /// To a full disk.
    Full,
}

impl Sink {
    fn stdio(self) -> Stdio {
        match self {
            Self::Here => Stdio::piped(),
            Self::Gone => std::io::pipe().unwrap().1.into(),
            Self::Full => OpenOptions::new().write(true).open("/dev/full").unwrap().into(),
        }
    }
}

fn run(folder: &Path, args: &str, stdout: Sink, stderr: Sink) -> Output {
    let mut command = command(folder, args);
    command.stdout(stdout.stdio()).stderr(stderr.stdio()).spawn().unwrap().wait_with_output().unwrap()
}

const RUN: &str = "uncertainty scene:ball --cameras cameras.json --level 4 --rays 1200 --occupancy 16";

/// A folder with cameras, fields, shards, samples, a mesh and points.
fn desk() -> Desk {
    let desk = Desk::new(3, 24);
    desk.write("points.csv", "id,x,y,z\n7,0.1,0.2,0.3\n");
    // Answers beyond 8 KB do not fit into any buffer of stdout.
    desk.write("many.csv", "0.1,0.2,0.3\n".repeat(20_000));
    desk.write("mesh.obj", TETRAHEDRON);
    desk.good(&format!("{RUN} --dump-samples samples.npz -o field.oct"));
    (0..2).for_each(|i| drop(desk.good(&format!("{RUN} --shard {i}/3 -o part{i}.oct"))));
    desk
}

/// What a verb writes, and its command; those marked have something to say on stderr.
const COMMANDS: [(&str, bool, &str); 10] = [
    ("new.oct", true, "uncertainty scene:ball --cameras cameras.json --level 4 --rays 1200 --audit -o new.oct"),
    ("", true, "query field.oct points.csv"),
    ("new.csv", false, "query field.oct many.csv -o new.csv"),
    ("", false, "compare field.oct part0.oct --points 100"),
    ("new.png", true, "render scene:ball part0.oct --cameras cameras.json --threshold 99% -o new.png"),
    ("new.html", false, "view scene:ball field.oct --cells 64 -o new.html"),
    ("new.oct", true, "merge part0.oct part1.oct -o new.oct"),
    ("", false, "info field.oct"),
    ("set", false, "synth mesh.obj -o set --count 2 --test-count 1 --resolution 16"),
    ("", false, "completions bash"),
];

fn remove(path: &Path) {
    let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
}

#[test]
fn notes_that_nobody_can_take_are_dropped_and_the_work_is_done() {
    let folder = &*desk();
    for (written, speaks, args) in COMMANDS {
        let written = folder.join(written);
        let usual = run(folder, args, Sink::Here, Sink::Here);
        let said = String::from_utf8(usual.stderr).unwrap();
        // Others may have something to say, too: on a slow machine, how far they are.
        assert!(usual.status.success() && (!speaks || !said.is_empty()), "{args}: {said}");
        for sink in [Sink::Gone, Sink::Full] {
            if written != folder {
                remove(&written);
            }
            let found = run(folder, args, Sink::Here, sink);
            assert_eq!(found.status.code(), Some(0), "{args}, stderr {sink:?}");
            assert_eq!(found.stdout.is_empty(), usual.stdout.is_empty(), "{args}, stderr {sink:?}");
            assert!(written.exists(), "{args}, stderr {sink:?}: nothing written");
        }
    }
}

#[test]
fn failures_that_nobody_can_take_keep_their_exit_code() {
    let folder = desk();
    for args in ["info missing.oct", "info", "uncertainty scene:none -o new.oct", "query field.oct points.csv -o x.txt"]
    {
        for sink in [Sink::Here, Sink::Gone, Sink::Full] {
            assert_eq!(run(&folder, args, Sink::Here, sink).status.code(), Some(2), "{args}, stderr {sink:?}");
        }
    }
}

/// A reader that has seen enough (`| head`) ends nothing; on a full disk the results are lost, which is a failure.
#[test]
fn results_that_nobody_wants_are_no_failure_and_those_that_are_lost_are() {
    let folder = &*desk();
    let ray =
        "query field.oct --model scene:ball --ray 0,-3,0.5,0,1,0".to_string() + &" --ray 0,-3,0,0,1,0".repeat(150);
    let more = ["query field.oct many.csv", ray.as_str(), "--help", "query --help", "--version"];
    for (written, args) in COMMANDS.iter().map(|(written, _, args)| (*written, *args)).chain(more.map(|m| ("", m))) {
        let run = |stdout: Sink| {
            if !written.is_empty() {
                remove(&folder.join(written));
            }
            run(folder, args, stdout, Sink::Here)
        };
        let usual = run(Sink::Here);
        assert!(usual.status.success(), "{args}: {}", String::from_utf8_lossy(&usual.stderr));
        let gone = run(Sink::Gone);
        let [said, silent] = [&usual, &gone].map(|output| String::from_utf8(output.stderr.clone()).unwrap());
        assert_eq!((gone.status.code(), silent.contains("\nerror:")), (Some(0), false), "{args}: {silent}");
        // Progress is told by the clock.
        let notes = |text: &str| text.lines().filter(|l| l.starts_with("note: ") || l.starts_with("warning: ")).count();
        assert_eq!(notes(&silent), notes(&said), "{args}: {silent}");
        if usual.stdout.is_empty() {
            continue;
        }
        let full = run(Sink::Full);
        let said = String::from_utf8(full.stderr).unwrap();
        assert_eq!(full.status.code(), Some(2), "{args}: {said}");
        let errors: Vec<&str> = said.lines().filter(|line| line.starts_with("error:")).collect();
        assert!(matches!(errors[..], [error] if error.starts_with("error: stdout: cannot write")), "{args}: {said}");
    }
}
