//! Output of the program in all stated formats, and its progress during long work.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::arrays::npy;
use crate::program::Desk;
use glam::Vec3;
use octobayes::field::{ClosedForm, VoxelGrid};
use octobayes_models::write_voxel_grid;

/// Shape of a `.npy` file, and its elements as 64-bit floats; by no code of the program.
pub fn read_npy(path: &Path) -> (Vec<u64>, Vec<f64>) {
    let bytes = std::fs::read(path).unwrap();
    let (head, data) = bytes.split_at(10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]])));
    let head = String::from_utf8_lossy(head);
    let shape = head.split_once("'shape': (").unwrap().1.split_once(')').unwrap().0;
    let extents = shape.split(',').filter_map(|extent| extent.trim().parse().ok()).collect();
    (extents, data.chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())).collect())
}

const FIELD: &str =
    "uncertainty scene:courtyard --cameras cameras.json --level 5 --rays 3000 --occupancy 32 -o field.oct";
const RENDER: &str = "render scene:courtyard field.oct";

fn with_field() -> Desk {
    let desk = Desk::new(4, 32);
    desk.good(FIELD);
    desk
}

#[test]
fn queries_answer_in_all_formats() {
    let desk = with_field();
    let field = desk.field("field.oct");
    let points = [[0.5_f32, 0.5, -0.125], [0.0, 0.0, 0.875], [3.0, 0.0, 0.0]];
    desk.write("points.npy", npy(&[3, 3], points.into_iter().flatten()));
    let csv: String = points.iter().map(|p| format!("{},{},{}\n", p[0], p[1], p[2])).collect();
    desk.write("points.csv", format!("x,y,z\n{csv}"));

    desk.good("query field.oct points.npy -o out.npy");
    let (shape, answers) = read_npy(&desk.join("out.npy"));
    assert_eq!(shape, [3, 2]);
    for (row, point) in answers.chunks_exact(2).zip(points) {
        let expected = field.query(point.into()).uncertainty;
        assert_eq!((row[0], row[1]), (expected, expected.log10()));
    }
    desk.good("query field.oct points.csv -o out.csv");
    let text = desk.text("out.csv");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[0], "x,y,z,uncertainty,log10_uncertainty,level,inside,rays,ray_coverage,seen");
    assert_eq!(lines.len(), 4);
    // Level, whether the point is inside, how many rays support the number, and what was seen. Outside, none can be.
    assert!(lines[1].contains(",5,1,") && !lines[1].ends_with(',') && lines[3].ends_with(",0,0,,0,unseen"), "{text}");
    assert!(lines[1].ends_with(",constrained") && lines[2].ends_with(",free"), "{text}");
    assert!(lines[3].contains(&field.prior().to_string()));

    // From stdin, from columns that are found by their names, and from arrays of other types.
    let mut child =
        desk.command("query field.oct - -o -").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(csv.as_bytes()).unwrap();
    assert_eq!(String::from_utf8(child.wait_with_output().unwrap().stdout).unwrap(), text);
    let named: String = points.iter().map(|p| format!("1,{},a,{},{}\n", p[2], p[1], p[0])).collect();
    desk.write("named.csv", format!("\u{feff}id,Z,name,Y,X\n{named}"));
    let (_, answers, notes) = desk.run("query field.oct named.csv -o -");
    assert!(answers == text && notes.contains("not: id, name"), "{notes}");
    desk.write("f16.npy", npy(&[3, 3], points.into_iter().flatten().map(half::f16::from_f32)));
    assert_eq!(desk.good("query field.oct f16.npy -o -"), text);
    desk.write("i64.npy", npy(&[1, 3], [3_i64, 0, 0]));
    assert_eq!(desk.good("query field.oct i64.npy -o -").lines().nth(1), Some(lines[3]));
}

/// Queries of a list longer than memory. The peak is that of the child process.
#[test]
#[cfg(target_os = "linux")]
fn queries_of_long_lists_take_no_more_memory() {
    let desk = with_field();
    // Whole batches of the program, so that all are answered before the input ends.
    let peak = |points: usize| -> u64 {
        let mut child =
            desk.command("query field.oct - -o -").stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let mut input = child.stdin.take().unwrap();
        let writer = std::thread::spawn(move || {
            let rows: String = (0..1 << 12).map(|i| format!("{},0.5,-0.1\n", f64::from(i) / 4096.0)).collect();
            (0..points >> 12).for_each(|_| input.write_all(rows.as_bytes()).unwrap());
            input
        });
        let mut answers = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        for _ in 0..=points {
            line.clear();
            answers.read_line(&mut line).unwrap();
        }
        let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap();
        drop(writer.join().unwrap());
        assert!(child.wait().unwrap().success() && line.split(',').count() == 10, "{line}");
        let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        peak.trim().strip_suffix(" kB").unwrap().parse::<u64>().unwrap() * 1024
    };
    let [short, long] = [1 << 18, 1 << 20].map(peak);
    // Answers in memory would be 88 bytes a point, 69 MB more; the allocator's own slack is a small part of one batch.
    assert!(long < short + (16 << 20), "{long} bytes for 1M points, {short} for 262k");
}

#[test]
fn error_bars_are_told_wherever_a_field_is() {
    let desk = Desk::new(4, 32);
    let run = "uncertainty scene:courtyard --cameras cameras.json --level 5 --occupancy 32 --keep-sums";
    desk.good(&format!("{run} --rays 6000 --error-bars -o bars.oct"));
    let value = desk.json("info bars.oct");
    let bars = &value["errors"]["rays"];
    assert!(bars["from"] == "groups" && bars["groups"] == 8 && bars["known"].as_u64() > Some(1000), "{bars}");
    assert!(bars["moved"].as_u64() >= bars["known"].as_u64(), "{bars}");
    assert!(bars["root_mean_square"].as_f64() > bars["median"].as_f64(), "{bars}");

    // Points where rays are plenty, where no ray came, and outside.
    desk.write("points.npy", npy(&[3, 3], [0.5_f32, 0.5, -0.1, 0.0, 0.0, 0.9, 3.0, 0.0, 0.0]));
    desk.good("query bars.oct points.npy -o out.npy");
    let (shape, answers) = read_npy(&desk.join("out.npy"));
    assert_eq!(shape, [3, 3]);
    assert!(answers[2] > 0.0 && answers[2] < 1.0 && answers[5].is_nan() && answers[8].is_nan());
    let text = desk.good("query bars.oct points.npy");
    let lines: Vec<&str> = text.lines().collect();
    assert!(lines[0].ends_with(",log10_error") && lines[1].ends_with(&format!(",{}", answers[2])), "{text}");
    assert!(lines[2].ends_with(','), "{text}");
    // Leaving the sums out leaves the errors alone. Another scalar has none.
    desk.good("export bars.oct -o bare.oct");
    desk.good("query bare.oct points.npy -o bare.npy");
    assert_eq!(desk.bytes("bare.npy"), desk.bytes("out.npy"));
    assert!(desk.said("query bars.oct points.npy -o block.npy --covariance block").contains("not those of `block`"));
    assert_eq!(read_npy(&desk.join("block.npy")).0, [3, 2]);

    // Fields of several seeds are groups, too.
    for seed in 1..=4 {
        desk.good(&format!("{run} --rays 1500 --seed {seed} -o part{seed}.oct"));
    }
    let parts = "part1.oct part2.oct part3.oct part4.oct";
    desk.good(&format!("merge {parts} -o merged.oct --error-bars"));
    let [one, merged] = ["bars.oct", "merged.oct"].map(|f| desk.field(f).error_summary().unwrap());
    // With as many rays the errors are the same, but for chance and the smaller number of groups.
    let ratio = merged.root_mean_square / one.root_mean_square;
    assert!(merged.groups == 4 && (0.75..1.33).contains(&ratio), "{merged:?} {one:?}");
    for conflict in ["--target-error 0.1", "--shard 0/2", "--dump-samples x.npz"] {
        desk.refused(&format!("{run} -o x.oct --error-bars {conflict}"), &["cannot be used with"]);
    }
}

/// An early version gave seeds 0 to 7 the same eight groups. Two such runs merged into twice the rays without a
/// word.
#[test]
fn error_bars_of_different_seeds_are_of_different_rays() {
    let desk = Desk::new(4, 32);
    let run = "uncertainty scene:courtyard --cameras cameras.json --level 4 --occupancy 32 --rays 3000 --keep-sums";
    for seed in [0, 3] {
        desk.good(&format!("{run} --error-bars --seed {seed} -o bars{seed}.oct"));
        desk.good(&format!("{run} --seed {seed} -o plain{seed}.oct"));
    }
    let [zero, three] = ["bars0.oct", "bars3.oct"].map(|name| desk.field(name));
    assert_eq!((zero.ray_sets().len(), three.ray_sets().len()), (8, 8));
    assert!(zero.deviations() != three.deviations(), "the same rays");

    desk.good("merge bars0.oct bars3.oct -o both.oct --error-bars --keep-sums");
    let both = desk.field("both.oct");
    assert_eq!((both.record().rays, both.ray_sets().len()), (6000, 16));
    // Twice the rays give 1/√2 of the error, within a factor of 3 because two groups are few. The same rays would
    // give 0.
    let [one, two] = [&zero, &both].map(|field| field.error_summary().unwrap().root_mean_square);
    assert!((0.3 / 2_f64.sqrt()..3.0 / 2_f64.sqrt()).contains(&(two / one)), "{one} of one, {two} of both");

    // Fields that share rays are distinguished from fields that do not, whatever the base seeds are.
    let group = zero.ray_sets()[5].seed;
    desk.good(&format!("{run} --seed {group} -o group.oct"));
    for parts in ["both.oct bars3.oct", "bars0.oct plain3.oct both.oct", "bars0.oct group.oct"] {
        desk.refused(&format!("merge {parts} -o x.oct"), &["rays in common"]);
    }
    desk.good("merge bars0.oct plain0.oct plain3.oct -o x.oct");
    assert_eq!(desk.field("x.oct").ray_sets().len(), 10);
}

#[test]
fn json_is_one_object_and_states_the_protocol() {
    let desk = Desk::new(4, 32);
    let value = desk.json(&format!("{FIELD} --seed 3"));
    assert_eq!((value["record"]["rays"].as_u64(), value["record"]["seed"].as_u64()), (Some(3000), Some(3)));
    for key in ["lambda", "covariance", "tolerance", "march_step", "difference_step", "cutoff", "background"] {
        assert!(!value["record"][key].is_null(), "{key}: {value}");
    }
    assert!(value["threads"].as_u64() > Some(0) && value["level"] == 5);
    desk.json("info scene:ball");
    let value = desk.json("compare field.oct field.oct --points 1000");
    assert!(value["in_box"]["max"] == 0.0 && value["on_surfaces"]["points"].as_u64() > Some(100));
}

#[test]
fn pictures_and_official_grids_are_written() {
    let desk = with_field();
    desk.good(&format!("{RENDER} --cameras cameras.json --frame 1 -o view.png --threshold 3.5"));
    desk.good(&format!("{RENDER} --cameras cameras.json --frame 1 -o view.exr"));
    let image = image::open(desk.join("view.png")).unwrap();
    assert!(image.width() > 3 * 32 && image.height() > 2 * 32);
    let exr = exr::prelude::read_first_flat_layer_from_file(desk.join("view.exr")).unwrap();
    let names: Vec<String> = exr.layer_data.channel_data.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["A", "B", "G", "R", "depth.Z", "log10_uncertainty.U", "uncertainty.U"]);

    // The ball stays away from the box's faces, where the official index order makes vertices share entries.
    let ball = FIELD.replace("courtyard", "ball").replace("field.oct", "ball.oct");
    desk.good(&format!("{ball} --keep-sums"));
    desk.good("export ball.oct -o unc.npy");
    assert_eq!(read_npy(&desk.join("unc.npy")).0, [33 * 33 * 33]);
    desk.good("export unc.npy -o unc.oct --box=-1,-1,-1,1,1,1 --rays 3000");
    let value = desk.json("compare ball.oct unc.oct --covariance trace --points 20000");
    for place in ["in_box", "on_surfaces"] {
        // Sums pass through f32. Hanging corners of coarse leaves stay within the tolerance.
        assert!(value[place]["max"].as_f64().unwrap() <= 0.01, "{place}: {value}");
    }
}

/// The preview is as wide as the picture would be, in 800 pixels; and nothing is squashed.
#[test]
fn pictures_are_previews_with_the_cameras_aspect_ratio_unless_told_otherwise() {
    let desk = with_field();
    let camera = ClosedForm::half_circle(1, [10, 1600])[0];
    octobayes_data::write_transforms(&desk.join("portrait.json"), &[("a".into(), camera)]).unwrap();
    for (args, expected) in
        [("", [5, 800]), ("--resize 1", [10, 1600]), ("--scale 0.1", [1, 160]), ("--resolution 2", [2, 320])]
    {
        let said = desk.said(&format!("{RENDER} --cameras portrait.json -o x.exr {args}"));
        let exr = exr::prelude::read_first_flat_layer_from_file(desk.join("x.exr")).unwrap();
        assert_eq!([exr.layer_data.size.0, exr.layer_data.size.1], expected, "{args}");
        assert_eq!(said.contains("preview of 5 x 800"), args.is_empty(), "{said}");
    }
    desk.refused(&format!("{RENDER} --cameras portrait.json --resize 1 --resolution 9 -o y.exr"), &["--resolution"]);
}

/// A log file of a long run says how far it is; one of a short run holds nothing.
#[test]
#[cfg(unix)]
#[ignore = "slow: whole runs as processes"]
fn long_work_tells_off_a_terminal_how_far_it_is() {
    let desk = Desk::new(4, 32);
    let is_progress =
        |line: &str| line.starts_with("rays: ") && line.contains(" %), about ") && line.contains(" s left");
    assert!(!desk.said(FIELD).lines().any(is_progress));
    let started = std::time::Instant::now();
    // Minutes in all; the time left is known from a fiftieth of it on.
    let long = format!("{} --threads 1", FIELD.replace("3000", "20M"));
    let mut child = desk.command(&long).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let line = lines.by_ref().map(Result::unwrap).find(|line| is_progress(line));
    assert!(line.is_some() && started.elapsed().as_secs() >= 10, "{line:?} after {:?}", started.elapsed());
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(lines.last().unwrap().unwrap().starts_with("error: interrupted"));
}

#[test]
fn shells_and_man_know_every_verb() {
    let desk = Desk::empty();
    let help = desk.good("--help");
    // Lines of longer descriptions are further indented.
    let commands = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let verbs = commands.filter_map(|line| line.strip_prefix("  ")?.split_once(' ').map(|(verb, _)| verb));
    let verbs: Vec<&str> = verbs.filter(|verb| !["", "help"].contains(verb)).collect();
    assert!(verbs.len() > 10 && !verbs.contains(&"completions"), "{verbs:?}");
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let script = desk.good(&format!("completions {shell}"));
        for word in verbs.iter().chain(&["dump-samples"]) {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
    desk.good("completions man -o share/man1");
    for verb in &verbs {
        let page = desk.text(&format!("share/man1/octobayes-{verb}.1"));
        assert!(page.contains(&format!(".TH octobayes-{verb} 1")) && page.contains(".SH SYNOPSIS"), "{page}");
    }
    assert!(desk.text("share/man1/octobayes.1").contains("octobayes\\-query(1)"));
}

#[test]
fn derivatives_and_the_number_of_rays_can_be_chosen() {
    let desk = Desk::new(4, 32);
    write_voxel_grid(&VoxelGrid::bake(&ClosedForm::ball(), [25; 3], Vec3::Z), &desk.join("ball.npz")).unwrap();
    let base = "uncertainty ball.npz --cameras cameras.json --level 4 --cutoff 1e-6";
    // Differences over a step that is small beside a voxel are the slope itself.
    desk.good(&format!("{base} --rays 4000 --gradient auto -o exact.oct"));
    desk.good(&format!("{base} --rays 4000 -o a.oct"));
    let [a, b] = ["a.oct", "exact.oct"].map(|name| desk.field(name));
    let found = octobayes::uncertainty::compare(&a, &b, 20_000, 0).unwrap().in_box.unwrap();
    // The bits differ, but kinks of the voxels rarely lie between the two sides of a difference.
    assert!(found.max > 0.0 && found.mean < 0.01, "{found:?}");
    desk.refused("uncertainty scene:ball --gradient analytic --rays 10 -o x.oct", &["differentiates itself"]);

    let audit = desk.good(&format!("{base} --rays 200000 --target-error 0.3 --audit -o few.oct"));
    for row in ["certain", "two halves", "samples left out", "finite differences", "difference step"] {
        assert!(audit.contains(row), "{row}: {audit}");
    }
    let rays = desk.field("few.oct").record().rays;
    assert!(rays < 200_000 && rays.is_power_of_two(), "{rays}");
    assert!(desk.said(&format!("{base} --rays 2000 --target-error 1e-9 -o more.oct")).contains("still above"));
}
