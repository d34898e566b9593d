//! Failures of the machine: a full disk, a folder that cannot be written, files that change while they are read,
//! processes killed while they write. Whatever happens, no field can be read that was not written whole.
#![cfg(unix)]

use std::collections::BTreeSet;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::interrupt::{send, wait_for};
use crate::program::{Desk, cameras, run};
use octobayes::uncertainty::UncertaintyField;
use octobayes_data::write_transforms;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

const PROGRAM: &str = env!("CARGO_BIN_EXE_octobayes");
const RUN: &str = "uncertainty scene:ball --cameras cameras.json --rays 2000 --occupancy 16";

/// A folder with cameras and two different fields.
fn desk(level: u8) -> Desk {
    let desk = Desk::new(3, 24);
    for (seed, name) in [(0, "old"), (1, "new")] {
        desk.good(&format!("{RUN} --keep-sums --grid dense --level {level} --seed {seed} -o {name}.oct"));
    }
    desk
}

/// Files that are being written, or were when their process was killed.
fn parts(folder: &Path) -> BTreeSet<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.filter(|path| path.extension().is_some_and(|e| e == "part")).collect()
}

fn quiet(desk: &Desk, args: &str) -> Child {
    desk.command(args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// A disk that is full after a kilobyte: `ulimit -f` makes longer writes fail with EFBIG, if the signal that comes
/// first is ignored.
#[test]
fn a_full_disk_leaves_what_was_there_and_nothing_else() {
    let desk = desk(4);
    desk.write("mesh.obj", crate::program::TETRAHEDRON);
    desk.write("points.csv", "0.1,0.2,0.3\n".repeat(300));
    let view = "render scene:ball old.oct --cameras cameras.json --frame 0";
    // Nothing has a checkpoint's name: it would pass for that of an unfinished run.
    for target in ["x.oct", "x.npy", "x.csv", "x.png", "x.exr", "x.npz", "x.htg", "x.ply"] {
        desk.write(target, "precious");
    }
    let before = desk.contents();
    for args in [
        format!("{RUN} --level 4 --keep-sums -o x.oct"),
        format!("{RUN} --level 4 -o y.oct --dump-samples x.npz"),
        // The state of a group is saved when it is complete.
        format!("{RUN} --level 4 -o y.oct --error-bars 2 --checkpoint x.chk"),
        "export old.oct -o x.npy".into(),
        "merge old.oct new.oct -o x.oct".into(),
        "query old.oct points.csv -o x.csv".into(),
        format!("{view} -o x.png"),
        format!("{view} -o x.exr"),
        "export old.oct -o x.npz".into(),
        "export old.oct -o x.htg".into(),
        "export scene:ball old.oct --cameras cameras.json -o x.ply".into(),
        "synth mesh.obj -o dataset --count 1 --test-count 1 --resolution 64".into(),
    ] {
        let script = format!("ulimit -f 1; exec {PROGRAM} {args}");
        let output = Command::new("sh").args(["-c", &script]).current_dir(&*desk).output().unwrap();
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args}: {stderr}");
        let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
        assert!(matches!(errors[..], [error] if error.contains("os error 27")), "{args}: {stderr}");
        assert!(desk.contents() == before, "{args} left or changed something");
    }
}

/// Frames that are there stay, and the message says so.
#[test]
fn an_interrupted_sequence_says_which_frames_are_there() {
    let desk = desk(4);
    write_transforms(&desk.join("many.json"), &cameras(60, [160, 160])).unwrap();
    let args = "render scene:ball old.oct --cameras many.json --frame 0..60 -o frames";
    let mut child = desk.command(args).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    wait_for(&desk.join("frames/frame_0001.png"), &mut child);
    send("-INT", &child);
    let output = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    let there = std::fs::read_dir(desk.join("frames")).unwrap().count();
    assert!(output.status.code() == Some(130) && (2..60).contains(&there), "{there}: {stderr}");
    assert!(stderr.contains(&format!("{there} of 60 frames")), "{stderr}");

    // Frames of `render` are replaced, those of another program are not.
    let few = args.replace("0..60", "0..2");
    desk.good(&few);
    image::RgbImage::new(2, 2).save(desk.join("frames/frame_0001.png")).unwrap();
    let frames = || [0, 1].map(|i| desk.bytes(&format!("frames/frame_000{i}.png")));
    let before = frames();
    desk.refused(&few, &["frames/frame_0001.png"]);
    assert!(frames() == before);
}

/// Permissions do not bind the superuser, who runs tests in many containers. So folders that nobody can write are
/// tested too, and a folder without permission only where it has an effect.
#[test]
fn a_folder_that_cannot_be_written_is_named() {
    use std::os::unix::fs::PermissionsExt;
    let desk = desk(4);
    std::fs::create_dir(desk.join("closed")).unwrap();
    std::fs::copy(desk.join("old.oct"), desk.join("closed/x.oct")).unwrap();
    std::fs::set_permissions(desk.join("closed"), std::fs::Permissions::from_mode(0o555)).unwrap();
    let binds = std::fs::write(desk.join("closed/probe"), "x").is_err();
    let outputs = [("old.oct/x.oct", true), ("/proc/x.oct", cfg!(target_os = "linux")), ("closed/x.oct", binds)];
    for (output, _) in outputs.iter().filter(|(_, is_closed)| *is_closed) {
        for args in [format!("export new.oct -o {output}"), format!("{RUN} --level 4 -o {output}")] {
            let error = desk.refused(&args, &["cannot create"]);
            assert!(error.starts_with(output), "{error}");
        }
    }
    assert!(desk.bytes("closed/x.oct") == desk.bytes("old.oct"));
}

/// Reads a field again and again while another thread writes two fields in turn with `replace`, until both fields, and
/// errors if there can be any, were met.
fn read_while(replace: impl Fn(&Path, &UncertaintyField, &[u8]) + Sync, can_fail: bool) {
    let desk = desk(4);
    // Without sums, which files round: what is written is what is read.
    let fields = ["old.oct", "new.oct"].map(|name| desk.field(name).without_sums());
    assert_ne!(fields[0], fields[1]);
    let path = desk.join("field.oct");
    let bytes = fields.each_ref().map(|field| {
        field.write(&path).unwrap();
        std::fs::read(&path).unwrap()
    });
    let done = AtomicBool::new(false);
    let mut met = [0; 4];
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let contents = fields.iter().zip(&bytes).cycle();
            contents.take_while(|_| !done.load(Ordering::Relaxed)).for_each(|(f, bytes)| replace(&path, f, bytes));
        });
        // Often enough that any possible outcome would have occurred. The last is one that must not occur.
        for _ in 0..200_000 {
            let outcome = match UncertaintyField::read(&path) {
                Ok(field) => fields.iter().position(|known| *known == field).unwrap_or(3),
                Err(_) => 2,
            };
            met[outcome] += 1;
            if met[0] >= 20 && met[1] >= 20 && (!can_fail || met[2] >= 20) {
                break;
            }
        }
        done.store(true, Ordering::Relaxed);
    });
    let [old, new, refused, other] = met;
    assert!(old >= 20 && new >= 20 && other == 0 && if can_fail { refused >= 20 } else { refused == 0 }, "{met:?}");
}

#[test]
fn a_field_that_is_replaced_as_this_program_does_is_always_whole() {
    read_while(|path, field, _| field.write(path).unwrap(), false);
}

/// As `cp` does: the file is truncated and grows again, or parts of it change while it keeps its length.
#[test]
fn a_field_that_is_overwritten_while_it_is_read_is_whole_or_refused() {
    for truncate in [true, false] {
        let replace = |path: &Path, _: &UncertaintyField, content: &[u8]| {
            let mut file = std::fs::OpenOptions::new().write(true).truncate(truncate).open(path).unwrap();
            for part in content.chunks(content.len() / 7) {
                file.write_all(part).unwrap();
                std::thread::yield_now();
            }
            file.set_len(content.len() as u64).unwrap();
            // Long enough for a reader to come by.
            (0..20).for_each(|_| std::thread::yield_now());
        };
        read_while(replace, true);
    }
}

/// A run names its input by checksums, so what it read must be what it names: the file is read for a checksum, for
/// its content, and for a checksum again.
#[test]
fn cameras_that_change_while_they_are_read_are_refused() {
    let desk = Desk::new(3, 24);
    let cameras = desk.text("cameras.json");
    let ended = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for i in (0..).take_while(|_| !ended.load(Ordering::Relaxed)) {
                // Whole at every moment, with a checksum of its own each time.
                desk.write("next.json", format!("{cameras}{}", "\n".repeat(i % 7)));
                std::fs::rename(desk.join("next.json"), desk.join("changing.json")).unwrap();
            }
        });
        while !desk.join("changing.json").exists() {
            std::thread::yield_now();
        }
        for attempt in 0.. {
            let args = "uncertainty scene:ball --cameras changing.json --level 2 --rays 600 -o x.oct";
            let output = run(&desk, args);
            let stderr = String::from_utf8(output.stderr).unwrap();
            let written = std::fs::remove_file(desk.join("x.oct")).is_ok();
            assert_eq!(output.status.success(), written, "{stderr}");
            if !written || attempt > 100 {
                ended.store(true, Ordering::Relaxed);
                assert!(stderr.contains("changing.json (") && stderr.contains("as before it was read"), "{stderr}");
                break;
            }
        }
    });
}

/// `kill -9` at random moments while a field is written: the target is what it was, or the whole new field. What
/// stays beside it has the name of a temporary file, and is a field only if it is whole.
#[test]
fn kills_while_writing_leave_no_half_field() {
    // 11 MB each.
    let desk = desk(7);
    ["old.oct", "new.oct"].iter().for_each(|name| desk.field(name).without_sums().write(&desk.join(name)).unwrap());
    let [old, new] = ["old.oct", "new.oct"].map(|name| desk.bytes(name));
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let (mut kills, mut left, mut attempts) = (0, 0, 0);
    while kills < 8 || left < 4 {
        attempts += 1;
        assert!(attempts <= 400, "{kills} kills, {left} of them while writing, in 400 attempts");
        // Sometimes there is nothing yet, sometimes the old field.
        let was = (attempts % 2 == 0).then_some(&old);
        match was {
            Some(old) => desk.write("x.oct", old),
            None => drop(std::fs::remove_file(desk.join("x.oct"))),
        }
        let mut child = quiet(&desk, "export new.oct -o x.oct");
        // When so many bytes are written.
        let goal = rng.random_range(1..new.len() as u64);
        let written = || parts(&desk).iter().filter_map(|part| part.metadata().ok()).map(|part| part.len()).max();
        while written().is_none_or(|length| length < goal) && child.try_wait().unwrap().is_none() {
            std::thread::yield_now();
        }
        child.kill().unwrap();
        let was_killed = child.wait().unwrap().code().is_none();
        kills += usize::from(was_killed);
        let is = std::fs::read(desk.join("x.oct")).ok();
        assert!(is.as_ref() == was || is.as_ref() == Some(&new), "neither what it was nor the new field");
        for part in parts(&desk) {
            left += 1;
            let name = part.file_name().unwrap().to_str().unwrap();
            assert!(was_killed && name.starts_with(".octobayes-") && name.ends_with(".part"), "{name}");
            let whole = std::fs::read(&part).unwrap() == new;
            assert_eq!(UncertaintyField::read(&part).is_ok(), whole, "half a field can be read");
            std::fs::remove_file(part).unwrap();
        }
    }
}

/// After `kill -9` parts of files stay behind, gigabytes after some nights. The next run that writes the same file
/// removes them, but none that another process is writing.
#[test]
fn what_killed_runs_left_is_removed_by_the_next_that_writes_the_same_file() {
    let desk = Desk::new(3, 24);
    let of_samples = || -> BTreeSet<PathBuf> {
        parts(&desk).into_iter().filter(|path| path.to_string_lossy().contains("-x.npz-")).collect()
    };
    // The samples are written from the first ray on, in four parts.
    let run = format!("{RUN} --level 4 -o x.oct --dump-samples x.npz");
    let start = || {
        let before = of_samples();
        let mut child = quiet(&desk, &run.replace("--rays 2000", "--rays 100M"));
        loop {
            let new: BTreeSet<PathBuf> = of_samples().difference(&before).cloned().collect();
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
    assert_eq!(of_samples(), left, "a killed process removes nothing");
    let other = desk.join(".octobayes-other.npz-ABCDEF.part");
    std::fs::write(&other, "of another file").unwrap();

    let (mut alive, written) = start();
    assert_eq!(of_samples(), written, "the next run removes what was left");
    desk.good(&run);
    assert!(desk.join("x.npz").exists());
    assert_eq!(of_samples(), written, "what another process writes stays");
    send("-TERM", &alive);
    assert_eq!(alive.wait().unwrap().code(), Some(130));
    assert_eq!(parts(&desk), BTreeSet::from([other]));
}
