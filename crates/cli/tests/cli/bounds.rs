//! Whatever number an option is given, the program refuses it by name or does its work: no panic, no signal, and
//! no more memory than a desk computer has. The options are those of `--help`, so that a new one is tried, too.
#![cfg(target_os = "linux")]

use std::process::{Command, Stdio};

use crate::program::{Desk, TETRAHEDRON};

/// What people type by accident, and what programs hand over when they fail.
const VALUES: [&str; 8] = ["", "0", "-1", "18446744073709551615", "1e300", "1e-300", "1e12", "nan"];

/// Names of values that are not numbers.
const NO_NUMBERS: &str = "PATH DIR FILE OUT FIELD.oct MODEL SAMPLES.npz SHEET.png PLOT.svg CURVES.csv VIEW.html \
    MODEL.safetensors DATASET PATTERN";

/// The fault of a run, if it has one. A run has 8 GB of address space. Numbers of rays and steps may take days, so a
/// signal ends it after a second, and it has a minute to do so.
fn fault(desk: &Desk, args: &[String]) -> Option<String> {
    let script = "ulimit -v 8000000; exec timeout --preserve-status -k 60 1 \"$0\" \"$@\"";
    let mut command = Command::new("sh");
    let command = command.args(["-c", script, env!("CARGO_BIN_EXE_octobayes")]).args(args).current_dir(&**desk);
    let output = command.stdin(Stdio::null()).output().unwrap();
    let said: String = String::from_utf8_lossy(&output.stderr).chars().take(300).collect();
    // 143: ended by the signal, as verbs do that have nothing to clean up.
    let is_sound = matches!(output.status.code(), Some(0 | 2 | 130 | 143)) && !said.contains("panicked");
    (!is_sound).then(|| format!("{args:?}: {:?}, stderr: {said}", output.status))
}

/// The options of a verb that take numbers, and the names of their values.
fn options(desk: &Desk, verb: &str) -> Vec<(String, String)> {
    let help = desk.good(&format!("{verb} --help"));
    let option = |line: &str| {
        let (name, value) = line.trim_start().split_once(" <").or_else(|| line.trim_start().split_once(" [<"))?;
        let name = name.rsplit(' ').next()?;
        let value = value.split_once('>')?.0;
        (name.starts_with("--") && line.starts_with(' ')).then(|| (name.to_string(), value.to_string()))
    };
    let found = help.lines().filter_map(option).filter(|(_, value)| !NO_NUMBERS.split(' ').any(|name| name == value));
    found.collect()
}

/// The texts that an option is given for one number.
fn texts(option: &str, name: &str, v: &str) -> Vec<String> {
    let all = |n: usize| vec![v; n].join(",");
    let plus = v.trim_start_matches('-');
    match name {
        "BOX" => vec![all(6), format!("-{plus},-{plus},-{plus},{plus},{plus},{plus}")],
        "NORM:X,Y,Z,R" | "NORM[:X,Y,Z,R]" => {
            vec![format!("l2:{}", all(4)), format!("linf:0,0,0,{v}"), format!("l2:{v},0,0,1"), v.into()]
        }
        "X,Y,Z,DX,DY,DZ" => vec![all(6), format!("0,-3,0,0,{v},0"), format!("{v},0,0,0,1,0")],
        "LOW,HIGH" => vec![all(2), format!("-1,{v}"), format!("{v},2")],
        "OFFSET,SCALE" => vec![all(2), format!("0,{v}")],
        "COLOR" => vec![all(3)],
        "K|A..B" => vec![v.into(), format!("0..{v}"), format!("{v}..18446744073709551615")],
        "I/N" => vec![format!("0/{v}"), format!("{v}/{v}"), format!("1/{v}")],
        "N|I,J,...|all" => vec![v.into(), format!("{v},")],
        "LOG10_U|PERCENT%" => vec![v.into(), format!("{v}%")],
        "SIZE" if option == "--resolution" => vec![v.into(), format!("{v}x{v}"), format!("65536x{v}")],
        _ => vec![v.into()],
    }
}

/// Gives every option of `verb` every number, beside `base`, from which the option itself and those `without` are
/// taken. Options that need others get them.
fn try_all(setup: &[&str], verb: &str, base: &str) {
    let desk = Desk::new(3, 12);
    desk.write("mesh.obj", TETRAHEDRON);
    setup.iter().for_each(|args| drop(desk.good(args)));
    desk.good(&format!("{verb} {base}"));
    let options = options(&desk, verb);
    assert!(options.len() > 1 || ["info", "merge"].contains(&verb), "{verb}: {options:?}");
    let mut faults = Vec::new();
    for (option, name) in &options {
        let (needs, excludes): (&[&str], &[&str]) = match option.as_str() {
            "--noise" => (&["--scale", "data", "--noise", "0.1"], &[]),
            "--contract" => (&[], &["--box"]),
            "--probability" => (&["--calibrate", "cal.oct"], &[]),
            "--cells" | "--density" if verb == "export" => (&["--mesh"], &[]),
            "--fov" => (&[], &["--cameras", "--views"]),
            "--resize" => (&[], &["--resolution"]),
            "--time" => (&[], &["--steps"]),
            _ => (&[], &[]),
        };
        let mut words: Vec<String> = base.split_whitespace().chain(needs.iter().copied()).map(String::from).collect();
        for left_out in excludes.iter().filter(|flag| !needs.contains(flag)).copied().chain([option.as_str()]) {
            while let Some(at) = words.iter().position(|word| word == left_out) {
                words.drain(at..at + 2);
            }
            words.retain(|word| !word.starts_with(&format!("{left_out}=")));
        }
        for text in VALUES.iter().flat_map(|v| texts(option, name, v)) {
            ["x.state", "x.chk"].iter().for_each(|name| drop(std::fs::remove_file(desk.join(name))));
            if verb == "synth" {
                let _ = std::fs::remove_dir_all(desk.join("set"));
            }
            let last = format!("{option}={text}");
            let args: Vec<String> = [verb.to_string()].into_iter().chain(words.clone()).chain([last]).collect();
            faults.extend(fault(&desk, &args));
        }
    }
    assert!(faults.is_empty(), "{} faults:\n{}", faults.len(), faults.join("\n"));
}

const FIELD: &str = "uncertainty scene:ball --cameras cameras.json --level 3 --rays 600 --occupancy 16 \
    --keep-sums -o field.oct";
const SYNTH: &str = "synth mesh.obj -o set --count 2 --test-count 1 --resolution 8 --samples-per-pixel 1";

#[test]
#[ignore = "slow: whole runs as processes"]
fn uncertainty() {
    let base = "scene:ball --cameras cameras.json --level 3 --rays 600 --occupancy 16 -o x.oct";
    try_all(&[], "uncertainty", base);
}

#[test]
fn accumulate() {
    let samples = format!("{FIELD} --dump-samples samples.npz");
    try_all(&[&samples], "uncertainty", "samples.npz --box=-1,-1,-1,1,1,1 --level 3 -o x.oct");
}

#[test]
fn query() {
    try_all(&[FIELD], "query", "field.oct --ray 0,-3,0.5,0,1,0 --model scene:ball");
}

#[test]
fn compare_info_and_merge() {
    try_all(&[FIELD], "compare", "field.oct field.oct --points 100");
    try_all(&[FIELD], "info", "field.oct");
    let others = ["0", "1"].map(|seed| format!("{FIELD} --seed {seed}").replace("field.oct", &format!("{seed}.oct")));
    try_all(&[&others[0], &others[1]], "merge", "0.oct 1.oct -o x.oct");
}

#[test]
fn render() {
    let base = "scene:ball field.oct --cameras cameras.json --resolution 8 -o x.png";
    try_all(&[FIELD], "render", base);
}

#[test]
fn view() {
    let base = "scene:ball field.oct --cameras cameras.json --cells 32 -o x.html";
    try_all(&[FIELD], "view", base);
}

#[test]
fn export() {
    let base = "scene:ball field.oct --cameras cameras.json --pixels 100 -o x.ply";
    try_all(&[FIELD], "export", base);
}

#[test]
fn evaluate() {
    let field = FIELD.replace("--keep-sums", "--scale data --noise 0.1");
    let set = "synth mesh.obj -o other --count 1 --test-count 3 --resolution 24 --samples-per-pixel 1";
    let base = "scene:ball field.oct --cameras other/transforms_test.json";
    try_all(&[&field, set], "evaluate", &format!("{base} --clean-up x.png"));
    let calibrate = "--depth other/depth --depth-pattern {}.exr --calibrate x.oct";
    try_all(&[&field, set], "evaluate", &format!("{base} {calibrate}"));
}

#[test]
fn synth() {
    try_all(&[], "synth", SYNTH.strip_prefix("synth ").unwrap());
}

#[test]
#[ignore = "slow: whole runs as processes"]
fn train() {
    let base = "set -o x.safetensors --steps 2 --log2-hashmap-size 8 --samples-per-step 1024";
    try_all(&[SYNTH], "train", base);
}

#[test]
fn demo() {
    try_all(&[], "demo", "--scene ball --level 4 --rays 1000 --output x");
}

/// What the table of values rests on.
#[test]
fn options_are_found_in_the_help() {
    let found = options(&Desk::empty(), "uncertainty");
    for wanted in ["--threads", "--lambda", "--box", "--error-bars", "--rays", "--noise"] {
        assert!(found.iter().any(|(option, _)| option == wanted), "{wanted}: {found:?}");
    }
    assert!(found.len() > 20 && !found.iter().any(|(option, _)| option == "--cameras"), "{found:?}");
}
