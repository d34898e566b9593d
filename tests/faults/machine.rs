//! Failures of the machine: a full disk, a folder that cannot be written, files that change while they are read,
//! processes killed while they write. Whatever happens, no field can be read that was not written whole.
#![cfg(unix)]

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::program::{good, run};
use octobayes::dataset::write_transforms;
use octobayes::field::ClosedForm;
use octobayes::uncertainty::UncertaintyField;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

const PROGRAM: &str = env!("CARGO_BIN_EXE_octobayes");
const RUN: &str = "uncertainty scene:ball --cameras cameras.json --rays 2000 --occupancy 16 --keep-sums";

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A folder with cameras, two different fields, samples, a mesh and points.
fn desk() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let cameras = ClosedForm::half_circle(3, [24, 24]).into_iter().enumerate();
    let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
    write_transforms(&folder.path().join("cameras.json"), &named).unwrap();
    good(folder.path(), &format!("{RUN} --grid dense --level 4 -o old.oct"));
    good(folder.path(), &format!("{RUN} --grid dense --level 4 --seed 1 -o new.oct"));
    folder
}

fn files(folder: &Path) -> BTreeSet<PathBuf> {
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect()
}

/// A disk that is full after a kilobyte: `ulimit -f` makes longer writes fail with EFBIG, if the signal that comes
/// first is ignored.
#[test]
fn a_full_disk_leaves_what_was_there_and_nothing_else() {
    let folder = desk();
    let folder = folder.path();
    std::fs::write(folder.join("mesh.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n")
        .unwrap();
    std::fs::write(folder.join("points.csv"), "0.1,0.2,0.3\n".repeat(300)).unwrap();
    good(folder, &format!("{RUN} --level 4 -o sampled.oct --dump-samples samples.npz"));
    let targets = ["x.oct", "x.npy", "x.csv", "x.png", "x.exr", "x.npz", "x.htg", "x.ply", "x.chk"];
    let view = "render scene:ball old.oct --cameras cameras.json --frame 0";
    let commands = [
        format!("{RUN} --level 4 -o x.oct"),
        format!("{RUN} --level 4 -o y.oct --dump-samples x.npz"),
        "uncertainty samples.npz --box=-1,-1,-1,1,1,1 --level 4 --keep-sums -o x.oct".into(),
        "export old.oct -o x.oct".into(),
        "export old.oct -o x.npy".into(),
        "merge old.oct new.oct -o x.oct".into(),
        "query old.oct points.csv -o x.csv".into(),
        "query old.oct points.csv -o x.npy".into(),
        format!("{view} -o x.png"),
        format!("{view} -o x.exr"),
        "export old.oct -o x.npz".into(),
        "export old.oct -o x.htg".into(),
        "export scene:ball old.oct --cameras cameras.json -o x.ply".into(),
        "synth mesh.obj -o dataset --count 1 --test-count 1 --resolution 64".into(),
    ];
    for target in targets {
        std::fs::write(folder.join(target), "precious").unwrap();
    }
    // Not present: a state would pass for that of an unfinished run.
    std::fs::remove_file(folder.join("x.chk")).unwrap();
    let before = files(folder);
    // The state of a group is saved when it is complete.
    let checkpoint = format!("{RUN} --level 4 -o y.oct --error-bars 2 --checkpoint x.chk");
    for args in commands.into_iter().chain([checkpoint]) {
        let script = format!("ulimit -f 1; exec {PROGRAM} {args}");
        let output = Command::new("sh").args(["-c", &script]).current_dir(folder).output().unwrap();
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args}: {stderr}");
        assert!(stderr.contains("cannot write") && stderr.contains("os error 27"), "{args}: {stderr}");
        assert!(!stderr.contains("panicked"), "{args}: {stderr}");
        // One line, and nothing before it on that line.
        let errors = stderr.lines().filter(|line| line.starts_with("error: ")).count();
        assert!(errors == 1 && stderr.matches("os error 27").count() == 1, "{args}: {stderr}");
        assert_eq!(files(folder), before, "{args} left something behind");
        for target in targets.iter().map(|target| folder.join(target)).filter(|path| path.exists()) {
            assert_eq!(std::fs::read(&target).unwrap(), b"precious", "{args}: {} was touched", target.display());
        }
    }
}

/// Frames that are there stay, and the message says so.
#[test]
fn an_interrupted_sequence_says_which_frames_are_there() {
    let folder = desk();
    let folder = folder.path();
    let cameras = ClosedForm::half_circle(60, [160, 160]).into_iter().enumerate();
    let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
    write_transforms(&folder.join("many.json"), &named).unwrap();
    let args = "render scene:ball old.oct --cameras many.json --frame 0..60 -o frames";
    let mut command = Command::new(PROGRAM);
    let child = command.args(args.split(' ')).current_dir(folder).stdout(Stdio::null()).stderr(Stdio::piped());
    let child = child.spawn().unwrap();
    let started = std::time::Instant::now();
    while !folder.join("frames/frame_0001.png").exists() {
        assert!(started.elapsed().as_secs() < 120, "no frame came");
        std::thread::sleep(Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{stderr}");
    let there = files(&folder.join("frames")).len();
    assert!((2..60).contains(&there), "{there}: the test must interrupt real progress");
    assert!(stderr.contains(&format!("error: interrupted; frames holds {there} of 60 frames")), "{stderr}");

    // Frames of `render` are replaced, those of another program are not.
    let [own, other] = ["frames/frame_0000.png", "frames/frame_0001.png"].map(|name| folder.join(name));
    let few = args.replace("0..60", "0..2");
    let run = || Command::new(PROGRAM).args(few.split(' ')).current_dir(folder).output().unwrap();
    assert!(run().status.success());
    let before = std::fs::read(&own).unwrap();
    image::RgbImage::new(2, 2).save(&other).unwrap();
    let foreign = std::fs::read(&other).unwrap();
    let output = run();
    let stderr = text(&output.stderr);
    assert!(output.status.code() == Some(2) && stderr.contains("found frames/frame_0001.png"), "{stderr}");
    assert!(std::fs::read(&own).unwrap() == before && std::fs::read(&other).unwrap() == foreign);
}

/// `/dev/full` accepts nothing.
#[test]
#[cfg(target_os = "linux")]
fn output_that_nobody_can_take_is_a_failure() {
    let folder = desk();
    for args in ["info old.oct", "info old.oct --json", "compare old.oct new.oct --points 100"] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut command = Command::new(PROGRAM);
        let output =
            command.args(args.split(' ')).current_dir(&folder).stdout(full).stderr(Stdio::piped()).output().unwrap();
        let stderr = text(&output.stderr);
        assert!(output.status.code() == Some(2) && stderr.contains("stdout: cannot write"), "{args}: {stderr}");
    }
}

/// Permissions do not bind the superuser, who runs tests in many containers. So folders that nobody can write are
/// tested too, and a folder without permission only where it has an effect.
#[test]
fn a_folder_that_cannot_be_written_is_named() {
    use std::os::unix::fs::PermissionsExt;
    let folder = desk();
    let folder = folder.path();
    let closed = folder.join("closed");
    std::fs::create_dir(&closed).unwrap();
    std::fs::copy(folder.join("old.oct"), closed.join("x.oct")).unwrap();
    std::fs::set_permissions(&closed, std::fs::Permissions::from_mode(0o555)).unwrap();
    let binds = std::fs::write(closed.join("probe"), "x").is_err();
    let mut outputs = vec!["old.oct/x.oct"];
    outputs.extend(cfg!(target_os = "linux").then_some("/proc/x.oct"));
    outputs.extend(binds.then_some("closed/x.oct"));
    let before = files(folder);
    for output in outputs {
        for args in [format!("export new.oct -o {output}"), format!("{RUN} --level 4 -o {output}")] {
            let found = run(folder, &args);
            let stderr = text(&found.stderr);
            assert_eq!(found.status.code(), Some(2), "{args}: {stderr}");
            // Notes on the cameras may come first.
            let error = stderr.lines().find(|line| line.starts_with("error: ")).unwrap_or_default();
            assert!(error.starts_with(&format!("error: {output}: cannot create")), "{args}: {stderr}");
        }
    }
    assert_eq!(files(folder), before);
    assert_eq!(std::fs::read(closed.join("x.oct")).unwrap(), std::fs::read(folder.join("old.oct")).unwrap());
}

/// One thread reads a field again and again while `replace` writes the two fields in turn, until both fields, and
/// errors if there can be any, were met.
fn read_while(replace: impl Fn(&Path, &UncertaintyField, &[u8]) + Sync, can_fail: bool) {
    let folder = desk();
    // Without sums, which files round: what is written is what is read.
    let read = |name: &str| UncertaintyField::read(&folder.path().join(name)).unwrap().without_sums();
    let fields = ["old.oct", "new.oct"].map(read);
    assert_ne!(fields[0], fields[1]);
    let path = folder.path().join("field.oct");
    let bytes = fields.each_ref().map(|field| {
        field.write(&path).unwrap();
        std::fs::read(&path).unwrap()
    });
    let done = AtomicBool::new(false);
    let met = std::thread::scope(|scope| {
        scope.spawn(|| {
            for (field, content) in fields.iter().zip(&bytes).cycle() {
                if done.load(Ordering::Relaxed) {
                    break;
                }
                replace(&path, field, content);
            }
        });
        let mut met = [0; 3];
        // Often enough that any possible outcome would have occurred.
        for _ in 0..200_000 {
            let outcome = match UncertaintyField::read(&path) {
                Ok(field) => fields.iter().position(|known| *known == field),
                Err(error) => {
                    if !can_fail {
                        done.store(true, Ordering::Relaxed);
                        panic!("{error}");
                    }
                    Some(2)
                }
            };
            match outcome {
                Some(outcome) => met[outcome] += 1,
                None => {
                    done.store(true, Ordering::Relaxed);
                    panic!("a field was read that nobody wrote");
                }
            }
            if met[0] >= 20 && met[1] >= 20 && (!can_fail || met[2] >= 20) {
                break;
            }
        }
        done.store(true, Ordering::Relaxed);
        met
    });
    assert!(met[0] >= 20 && met[1] >= 20 && (!can_fail || met[2] >= 20), "old, new, refused: {met:?}");
}

#[test]
fn a_field_that_is_replaced_as_this_program_does_is_always_whole() {
    read_while(|path, field, _| field.write(path).unwrap(), false);
}

/// As `cp` does: the file is truncated and grows again, or parts of it change while it keeps its length.
#[test]
fn a_field_that_is_overwritten_while_it_is_read_is_whole_or_refused() {
    let replace = |path: &Path, _: &UncertaintyField, content: &[u8]| {
        let mut file = std::fs::File::create(path).unwrap();
        for part in content.chunks(content.len() / 7) {
            file.write_all(part).unwrap();
            std::thread::yield_now();
        }
        // Long enough for a reader to come by.
        for _ in 0..20 {
            std::thread::yield_now();
        }
    };
    read_while(replace, true);
    let in_place = |path: &Path, _: &UncertaintyField, content: &[u8]| {
        let mut file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
        for part in content.chunks(content.len() / 7) {
            file.write_all(part).unwrap();
            std::thread::yield_now();
        }
        file.set_len(content.len() as u64).unwrap();
        for _ in 0..20 {
            std::thread::yield_now();
        }
    };
    read_while(in_place, true);
}

/// A run names its input by checksums, so what it read must be what it names: the file is read for a checksum, for
/// its content, and for a checksum again.
#[test]
fn cameras_that_change_while_they_are_read_are_refused() {
    let folder = desk();
    let folder = folder.path();
    let cameras = std::fs::read_to_string(folder.join("cameras.json")).unwrap();
    let ended = AtomicBool::new(false);
    let change = |path: &Path| {
        for i in 0.. {
            if ended.load(Ordering::Relaxed) {
                return;
            }
            // Whole at every moment, with a checksum of its own each time.
            std::fs::write(folder.join("next.json"), format!("{cameras}{}", "\n".repeat(i % 7))).unwrap();
            std::fs::rename(folder.join("next.json"), path).unwrap();
        }
    };
    let changing = folder.join("changing.json");
    std::fs::copy(folder.join("cameras.json"), &changing).unwrap();
    let met = |(output, _): &(Output, bool)| text(&output.stderr).contains("as before it was read");
    let mut outputs = Vec::new();
    std::thread::scope(|scope| {
        scope.spawn(|| change(&changing));
        while outputs.len() < 100 && !outputs.last().is_some_and(met) {
            let run = run(folder, "uncertainty scene:ball --cameras changing.json --level 2 --rays 600 -o x.oct");
            let written = std::fs::remove_file(folder.join("x.oct")).is_ok();
            outputs.push((run, written));
        }
        ended.store(true, Ordering::Relaxed);
    });
    let (refused, written) = outputs.pop().unwrap();
    let stderr = text(&refused.stderr);
    assert!(refused.status.code() == Some(2) && !written && stderr.contains("changing.json ("), "{stderr}");
    assert!(outputs.iter().all(|(output, written)| output.status.success() && *written), "{outputs:?}");
}

/// `kill -9` at random moments while a field is written: the target is what it was, or the whole new field. What
/// stays beside it has the name of a temporary file, and is a field only if it is whole.
#[test]
fn kills_while_writing_leave_no_half_field() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::copy(desk().path().join("cameras.json"), folder.join("cameras.json")).unwrap();
    // 11 MB each.
    let run = RUN.replace(" --keep-sums", "");
    good(folder, &format!("{run} --grid dense --level 7 -o old.oct"));
    good(folder, &format!("{run} --grid dense --level 7 --seed 1 -o new.oct"));
    let bytes = ["old.oct", "new.oct"].map(|name| std::fs::read(folder.join(name)).unwrap());
    assert_ne!(bytes[0], bytes[1]);
    let target = folder.join("x.oct");
    let parts =
        || files(folder).into_iter().filter(|path| path.extension().is_some_and(|e| e == "part")).collect::<Vec<_>>();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut kills, mut left, mut attempts) = (0, 0, 0);
    while kills < 24 || left < 12 {
        attempts += 1;
        assert!(attempts <= 1000, "{kills} kills, {left} of them while writing, in 1000 attempts");
        // Sometimes there is nothing yet, sometimes the old field.
        match attempts % 2 {
            0 => std::fs::copy(folder.join("old.oct"), &target).map(drop).unwrap(),
            _ => drop(std::fs::remove_file(&target)),
        }
        let was = std::fs::read(&target).ok();
        let mut command = Command::new(PROGRAM);
        command
            .args(["export", "new.oct", "-o", "x.oct"])
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        // When so many bytes are written.
        let goal = rng.random_range(1..bytes[1].len() as u64);
        let written = || parts().iter().filter_map(|part| part.metadata().ok()).map(|part| part.len()).max();
        while written().is_none_or(|length| length < goal) && child.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        child.kill().unwrap();
        let was_killed = child.wait().unwrap().code().is_none();
        kills += usize::from(was_killed);
        let is = std::fs::read(&target).ok();
        assert!(is == was || is.as_ref() == Some(&bytes[1]), "the target is neither what it was nor the new field");
        for part in parts() {
            left += 1;
            let name = part.file_name().unwrap().to_str().unwrap();
            assert!(was_killed && name.starts_with(".octobayes-") && name.ends_with(".part"), "{name}");
            let whole = std::fs::read(&part).unwrap() == bytes[1];
            assert_eq!(UncertaintyField::read(&part).is_ok(), whole, "half a field can be read");
            std::fs::remove_file(part).unwrap();
        }
    }
}

/// After `kill -9` parts of files stay behind, gigabytes after some nights. The next run that writes the same file
/// removes them, but none that another process is writing.
#[test]
fn what_killed_runs_left_is_removed_by_the_next_that_writes_the_same_file() {
    let folder = desk();
    let folder = folder.path();
    let parts = || -> BTreeSet<PathBuf> {
        files(folder).into_iter().filter(|path| path.extension().is_some_and(|e| e == "part")).collect()
    };
    let of_samples = |parts: BTreeSet<PathBuf>| -> BTreeSet<PathBuf> {
        parts.into_iter().filter(|path| path.to_string_lossy().contains("-x.npz-")).collect()
    };
    // The samples are written from the first ray on, in four parts.
    let start = || {
        let args = format!("{RUN} --level 4 -o x.oct --dump-samples x.npz").replace("--rays 2000", "--rays 100M");
        let before = of_samples(parts());
        let mut child = Command::new(PROGRAM)
            .args(args.split_whitespace())
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        loop {
            let new: BTreeSet<PathBuf> = of_samples(parts()).difference(&before).cloned().collect();
            if new.len() == 4 {
                return (child, new);
            }
            assert!(child.try_wait().unwrap().is_none(), "the run ended");
            std::thread::sleep(Duration::from_millis(5));
        }
    };
    let (mut killed, left) = start();
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert_eq!(of_samples(parts()), left, "a killed process removes nothing");
    let other = folder.join(".octobayes-other.npz-ABCDEF.part");
    std::fs::write(&other, "of another file").unwrap();

    let (mut alive, written) = start();
    assert_eq!(of_samples(parts()), written, "the next run removes what was left");
    good(folder, &format!("{RUN} --level 4 -o x.oct --dump-samples x.npz"));
    assert!(folder.join("x.npz").exists());
    assert_eq!(of_samples(parts()), written, "what another process writes stays");
    assert!(Command::new("kill").args(["-TERM", &alive.id().to_string()]).status().unwrap().success());
    assert_eq!(alive.wait().unwrap().code(), Some(130));
    assert_eq!(parts(), BTreeSet::from([other]));
}
