//! `clean`: a file of splats in, the same format out, and what was removed beside it.

use glam::{Quat, Vec3};
use octobayes::field::{RadianceField, VoxelGrid};
use octobayes::geometry::Aabb;
use octobayes_data::write_transforms;
use octobayes_models::{read_voxel_grid, write_voxel_grid};
use octobayes_splats::{RenderMode, Splats};
use serde_json::Value;

use crate::program::Desk;
use crate::splats::{around, ball};

/// A ball of 900 splats, and behind these 30 that float around it.
fn with_floaters() -> Splats {
    let ball = ball(|_| 0.0);
    let n = ball.len();
    let place = |i: usize| 1.2 * Quat::from_rotation_z(0.21 * i as f32).mul_vec3(Vec3::new(1.0, 0.0, 0.2));
    let all = |i: usize| if i < n { ball.mean(i) } else { place(i - n) };
    Splats::new(
        (0..n + 30).map(all).collect(),
        (0..n + 30).map(|i| if i < n { ball.log_scales()[i] } else { Vec3::splat(-3.4) }).collect(),
        (0..n + 30).map(|i| if i < n { ball.rotation(i) } else { Quat::IDENTITY }).collect(),
        (0..n + 30).map(|i| if i < n { ball.opacity_logits()[i] } else { -0.5 }).collect(),
        (0..n + 30).flat_map(|i| ball.sh(i % n).to_vec()).collect(),
        1,
        RenderMode::Classic,
    )
    .unwrap()
}

/// The splats and twelve cameras around them.
fn desk() -> Desk {
    let desk = Desk::empty();
    let label: Vec<f32> = (0..930).map(|i| i as f32).collect();
    with_floaters().write_ply(&desk.join("scene.ply"), &[("label", &label)], &[]).unwrap();
    write_transforms(&desk.join("transforms.json"), &around(3.0, (0..12).map(|i| 0.52 * f64::from(i)))).unwrap();
    desk
}

fn read(desk: &Desk, name: &str) -> Splats {
    Splats::read(&desk.join(name)).unwrap()
}

const RUN: &str = "clean scene.ply --cameras transforms.json --background black";

#[test]
fn floaters_go_and_everything_else_stays_as_it_was() {
    let desk = desk();
    let answer = desk.good(&format!("{RUN} -o clean.ply --report clean.csv"));
    assert_eq!(answer, "clean.ply\nclean.removed.ply\n");
    let (kept, removed) = (read(&desk, "clean.ply"), read(&desk, "clean.removed.ply"));
    let column = |splats: &Splats, name: &str| splats.extra(name).unwrap_or_else(|| panic!("column {name}"));
    let numbers = |splats: &Splats| column(splats, "label").iter().map(|v| *v as usize).collect::<Vec<_>>();
    // The order stays, nothing is lost, and all floaters are gone.
    let (kept_numbers, gone) = (numbers(&kept), numbers(&removed));
    assert!(kept_numbers.is_sorted() && gone.is_sorted());
    assert_eq!(kept.len() + removed.len(), 930);
    assert!((900..930).all(|i| gone.contains(&i)), "{gone:?}");
    assert!(kept_numbers.len() > 850, "{} are left", kept.len());
    // Their numbers are those of the file, bit for bit.
    let scene = read(&desk, "scene.ply");
    for (k, &i) in kept_numbers.iter().enumerate() {
        assert_eq!(
            (kept.mean(k), kept.log_scales()[k], kept.sh(k)),
            (scene.mean(i), scene.log_scales()[i], scene.sh(i))
        );
    }
    let names = ["octobayes_reason", "octobayes_score", "front_share", "views"];
    assert!(kept.extra_names().ends_with(&names) && removed.extra_names().ends_with(&names));
    // 1 is floating.
    let reasons = column(&removed, "octobayes_reason");
    assert!(gone.iter().zip(&reasons).all(|(i, reason)| (*i >= 900) == (*reason == 1.0)), "{reasons:?}");
    assert!(column(&kept, "octobayes_reason").iter().all(|reason| *reason == 0.0));
    assert!(column(&removed, "front_share")[gone.len() - 1] > 0.7);
    // The report has a row for every splat, in the file's order.
    let report = std::fs::read_to_string(desk.join("clean.csv")).unwrap();
    let rows: Vec<Vec<&str>> = report.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 930);
    for (i, row) in rows.iter().enumerate() {
        assert_eq!(row[0], i.to_string());
        assert_eq!(row[4] == "kept" || row[5] == "strong", kept_numbers.contains(&i), "{row:?}");
    }
    // What was written is read again without a remark about its columns.
    let said = desk.said("info clean.ply");
    assert!(!said.contains("octobayes_reason"), "{said}");
}

#[test]
fn counts_are_printed_for_people_and_programs() {
    let desk = desk();
    let said = desk.said(&format!("{RUN} -o a.ply --strength careful"));
    assert!(said.contains(" of 930 splats (") && said.contains("%), careful:"), "{said}");
    assert!(said.contains("float in front of what the photographs show"), "{said}");
    let answer: Value = serde_json::from_str(&desk.good(&format!("{RUN} -o b.ply --json"))).unwrap();
    let floating = |strength: &str| answer["reasons_by_strength"][strength]["floating"].as_u64().unwrap();
    assert!(floating("careful") <= floating("normal") && floating("normal") <= floating("strong"));
    assert_eq!(answer["reasons"], answer["reasons_by_strength"]["normal"]);
    let gone: u64 = answer["reasons"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(answer["left"].as_u64().unwrap() + gone, 930);
    assert_eq!((answer["splats"].as_u64(), answer["strength"].as_str()), (Some(930), Some("normal")));
}

#[test]
fn the_format_that_comes_in_goes_out_and_others_by_their_name() {
    let desk = desk();
    let scene = read(&desk, "scene.ply");
    for name in ["scene.spz", "scene.splat", "scene.compressed.ply"] {
        scene.write(&desk.join(name)).unwrap();
        let again = read(&desk, name);
        let out = name.replace("scene", "out");
        desk.good(&format!("clean {name} --cameras transforms.json --background black -o {out}"));
        let (left, removed) = (read(&desk, &out), read(&desk, "out.removed.ply"));
        assert_eq!(left.len() + removed.len(), 930, "{name}");
        assert!((30..80).contains(&removed.len()), "{name}: {}", removed.len());
        let far = |x: &Vec3| again.means().iter().map(|y| (x - y).abs().max_element()).fold(f32::INFINITY, f32::min);
        // Chunks have other ranges than before, within a scene 2.4 long; others keep their bits.
        let half_a_step = if name.contains("compressed") { 0.5 * 2.4 / 1023.0 + 1e-6 } else { 0.0 };
        assert!(left.means().iter().all(|x| far(x) <= half_a_step), "{name}");
    }
    let said = desk.said(&format!("{RUN} -o out.splat"));
    assert!(said.contains("warning: out.splat has no place for property `label`"), "{said}");
    assert!(said.contains("has no place for colours that depend on the direction"), "{said}");
}

#[test]
fn what_cannot_be_cleaned_is_refused_with_the_way_out() {
    let desk = desk();
    desk.refused("clean scene.ply -o a.ply", &["--cameras: expected"]);
    desk.refused(&format!("{RUN} -o a.sog"), &["`.ply`, `.compressed.ply`, `.spz` or `.splat`"]);
    desk.refused(&format!("{RUN} -o scene.ply"), &["a file of its own"]);
    desk.refused(&format!("{RUN} -o a.ply --removed a.ply"), &["a file of its own"]);
    desk.refused(&format!("{RUN} -o a.ply --removed a.spz"), &["--removed: expected a name that ends in `.ply`"]);
    let of_volume = "clean scene:ball --cameras transforms.json";
    desk.refused(&format!("{of_volume} -o a.ply"), &["--output: expected `.npz`", "found a.ply"]);
    desk.refused(&format!("{of_volume} -o a.safetensors"), &["`.safetensors` of a hash grid of `train`"]);
    desk.refused(&format!("{of_volume} -o a.npz --removed b.ply"), &["--removed: expected Gaussian splats"]);
    // Cameras that look away see nothing.
    let away = around(3.0, [0.0].into_iter()).into_iter().map(|(name, mut camera)| {
        camera.position *= 100.0;
        camera.axes.y_axis *= -1.0;
        camera.axes.z_axis *= -1.0;
        (name, camera)
    });
    write_transforms(&desk.join("away.json"), &away.collect::<Vec<_>>()).unwrap();
    desk.refused(
        "clean scene.ply --cameras away.json --background black -o a.ply",
        &["cameras: expected rays that meet"],
    );
    assert!(!desk.join("a.ply").exists());
}

#[test]
fn what_is_left_is_trained_further_on_the_images() {
    let desk = Desk::empty();
    let gem = "v 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\nf 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\n\
               f 2 3 6\nf 4 2 6\nf 1 4 6\n";
    std::fs::write(desk.join("gem.obj"), gem).unwrap();
    desk.good("synth gem.obj -o gem --count 6 --test-count 1 --resolution 40 --up z");
    std::fs::create_dir(desk.join("splats")).unwrap();
    desk.good("train gem --splats --steps 200 -o splats/gem.ply");
    let trained = read(&desk, "splats/gem.ply");
    let number: Vec<f32> = (0..trained.len()).map(|i| i as f32).collect();
    trained.write_ply(&desk.join("gem.ply"), &[("number", &number)], &[]).unwrap();
    let run = "clean gem.ply --strength strong --cameras";
    let said = desk.said(&format!("{run} gem/transforms_train.json -o refit.ply --refit 60"));
    let psnr = said.split_once("60 steps of training: PSNR ").unwrap().1;
    let [before, after] = [0, 2].map(|word| psnr.split(' ').nth(word).unwrap().parse::<f64>().unwrap());
    assert!(after > before, "{said}");
    desk.good(&format!("{run} gem/transforms_train.json -o plain.ply"));
    // The same splats in the same order with other numbers.
    let (plain, refit) = (read(&desk, "plain.ply"), read(&desk, "refit.ply"));
    assert!(plain.len() < trained.len());
    assert_eq!(plain.extra("number"), refit.extra("number"));
    assert_eq!(plain.extra_names(), refit.extra_names());
    assert!((0..plain.len()).all(|i| plain.sh(i) != refit.sh(i)));
    desk.refused(&format!("{run} splats/cameras.json -o a.ply --refit 9"), &["--refit: expected cameras with their"]);
    let of_volume = "clean scene:ball --cameras gem/transforms_train.json -o a.npz --refit 9";
    desk.refused(of_volume, &["--refit: expected Gaussian splats"]);
}

#[test]
fn a_field_adds_a_column_and_may_decide_alone() {
    let desk = desk();
    desk.good(&RUN.replace("clean scene.ply", "uncertainty scene.ply -o scene.oct --level 5 --rays 20000"));
    let run = RUN.replace("scene.ply", "scene.ply scene.oct");
    desk.good(&format!("{run} -o views.ply --report views.csv"));
    desk.good(&format!("{RUN} -o plain.ply"));
    let (views, plain) = (read(&desk, "views.ply"), read(&desk, "plain.ply"));
    // The column says nothing of what goes.
    assert_eq!(views.means(), plain.means());
    assert!(views.extra_names().contains(&"uncertainty") && !plain.extra_names().contains(&"uncertainty"));
    let report = std::fs::read_to_string(desk.join("views.csv")).unwrap();
    let uncertainties: Vec<f64> =
        report.lines().skip(1).map(|row| row.rsplit(',').next().unwrap().parse().unwrap()).collect();
    assert_eq!(uncertainties.len(), 930);
    // By U alone those go that have the largest, at any strength.
    for strength in ["careful", "strong"] {
        let said = desk.said(&format!("{run} -o u.ply --by uncertainty --strength {strength}"));
        let share = if strength == "careful" { "99.9%" } else { "95%" };
        let (_, note) = said.split_once("log10 U is at most ").unwrap();
        let (limit, rest) = note.split_once(' ').unwrap();
        assert!(rest.starts_with(&format!("on {share} of the visible surfaces")), "{said}");
        let limit = 10_f64.powf(limit.parse::<f64>().unwrap());
        let (kept, gone) = (read(&desk, "u.ply"), read(&desk, "u.removed.ply"));
        let range = |splats: &Splats| {
            let u = splats.extra("uncertainty").unwrap();
            [u.iter().copied().fold(f64::INFINITY, f64::min), u.iter().copied().fold(0.0, f64::max)]
        };
        assert_eq!(kept.len() + gone.len(), 930);
        // The limit is printed with three digits.
        let [kept_most, gone_least] = [range(&kept)[1], range(&gone)[0]];
        assert!(kept_most < 1.0012 * limit && gone_least > limit / 1.0012, "{strength}: {kept_most} {gone_least}");
        assert!(gone.extra("octobayes_reason").unwrap().iter().all(|reason| *reason == 5.0));
    }
    desk.refused(&format!("{RUN} -o a.ply --by uncertainty"), &["--by uncertainty: expected FIELD.oct"]);
    desk.refused(&format!("{run} -o a.ply --splat-mode mip"), &["--splat-mode: expected none beside FIELD"]);
    // What lies outside the field stays, whatever the prior is there.
    let inside = RUN.replace("clean scene.ply", "uncertainty scene.ply -o small.oct --box=-1,-1,-1,1,1,1 --level 5");
    desk.good(&format!("{inside} --rays 20000"));
    let small = RUN.replace("scene.ply", "scene.ply small.oct");
    let said = desk.said(&format!("{small} -o small.ply --by uncertainty --strength strong"));
    assert!(said.contains("of 930 parts lie outside the field's box"), "{said}");
    let far = |splats: &Splats| splats.means().iter().filter(|x| x.abs().max_element() > 1.0).count();
    let (kept, scene) = (read(&desk, "small.ply"), with_floaters());
    assert!(far(&scene) > 10 && far(&kept) == far(&scene), "{} of {}", far(&kept), far(&scene));
}

/// Fog behind the ball, which no pixel shows, has a large U.
#[test]
fn hidden_matter_of_a_volume_goes_by_uncertainty_alone() {
    let desk = desk();
    write_voxel_grid(&voxels(), &desk.join("model.npz")).unwrap();
    // From one side: the fog is before the ball, and the far half of the ball is hidden.
    write_transforms(&desk.join("side.json"), &around(3.0, [-0.3, 0.0, 0.3].into_iter())).unwrap();
    desk.good("uncertainty model.npz --cameras side.json --background black --level 5 --rays 20000 -o model.oct");
    let run = "clean model.npz model.oct --cameras side.json --background black --strength careful";
    desk.good(&format!("{run} -o views.npz"));
    desk.good(&format!("{run} -o u.npz --by uncertainty"));
    let [views, u] = ["views.npz", "u.npz"].map(|name| read_voxel_grid(&desk.join(name)).unwrap());
    let hidden = |grid: &VoxelGrid| {
        let is = |i: &usize| grid.point(*i).x < -0.3 && grid.point(*i).length() < 0.6 && grid.values()[*i][3] > 0.0;
        (0..grid.values().len()).filter(is).count()
    };
    let (all, by_views, by_u) = (hidden(&voxels()), hidden(&views), hidden(&u));
    assert_eq!(by_views, all, "the inside of what was seen stays");
    assert!(2 * by_u < all, "{by_u} of {all}");
}

/// A ball of voxels, and thin fog beside it, which all cameras look through at the ball or past it.
fn voxels() -> VoxelGrid {
    let (bounds, n) = (Aabb::centered_cube(1.5), 48);
    let at = |i: usize| [i / (n * n), i / n % n, i % n].map(|k| 3.0 * k as f32 / (n - 1) as f32 - 1.5);
    let value = |i: usize| {
        let x = Vec3::from_array(at(i));
        let density = if x.length() < 0.7 { 80.0 } else { 1.5 * f32::from(is_fog(x)) };
        [0.5, 0.4, 0.3, density]
    };
    VoxelGrid::new(bounds, [n; 3], (0..n * n * n).map(value).collect()).unwrap()
}

const FOG: Vec3 = Vec3::new(0.95, 0.0, 0.0);

fn is_fog(x: Vec3) -> bool {
    x.distance(FOG) < 0.16
}

#[test]
fn a_voxel_grid_keeps_all_but_its_fog() {
    let desk = desk();
    write_voxel_grid(&voxels(), &desk.join("model.npz")).unwrap();
    let run = "clean model.npz --cameras transforms.json --background black";
    assert_eq!(desk.good(&format!("{run} -o clean.npz --report clean.csv --page clean.html")), "clean.npz\n");
    let (before, after) = (voxels(), read_voxel_grid(&desk.join("clean.npz")).unwrap());
    assert_eq!((before.shape(), before.bounds()), (after.shape(), after.bounds()));
    let (mut gone, grid) = (0, &after);
    for (i, (before, after)) in before.values().iter().zip(after.values()).enumerate() {
        let x = grid.point(i);
        let goes = is_fog(x) && after[3] == 0.0;
        gone += usize::from(goes);
        assert!(goes || before == after, "{x}: {before:?}, {after:?}");
    }
    let fog = (0..before.values().len()).filter(|&i| is_fog(before.point(i))).count();
    assert!(10 * gone >= 9 * fog, "{gone} of {fog} points of the fog");
    // A row for every cell with matter, in scene units.
    let report = std::fs::read_to_string(desk.join("clean.csv")).unwrap();
    let rows: Vec<Vec<&str>> = report.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0][..5], ["cell", "x", "y", "z", "reason"]);
    let floating = rows.iter().skip(1).filter(|row| row[4] == "floating" && row[5] != "strong");
    let number = |row: &[&str], k: usize| row[k].parse::<f64>().unwrap();
    let (mut all, mut of_fog) = (0.0, 0.0);
    for row in floating {
        let x = Vec3::from_array([1, 2, 3].map(|k| number(row, k) as f32));
        all += number(row, 8);
        // Half the diagonal of a cell, and the diagonal of a voxel: the fog's edge falls off over one.
        let reach = 0.16 + 3_f32.sqrt() * (0.5 * 3.0 / 48.0 + 3.0 / 47.0);
        of_fog += if x.distance(FOG) < reach { number(row, 8) } else { 0.0 };
    }
    // The rest is at the rim of the ball, where single pixels are looked at.
    assert!(of_fog > 0.95 * all, "{of_fog} of {all}");
    // What is left is a model like any other, and has nothing more to clean.
    let answer: Value = serde_json::from_str(
        &desk.good("clean clean.npz --cameras transforms.json --background black -o again.npz --json"),
    )
    .unwrap();
    assert!(answer["cells"].as_u64().unwrap() > 1000 && answer["removed"].is_null(), "{answer}");
    // Four views, each before, and marked and after at three strengths.
    let page = std::fs::read_to_string(desk.join("clean.html")).unwrap();
    assert_eq!(page.matches("data:image/jpeg;base64,").count(), 4 * 7);
    assert!(page.contains("<title>model.npz: before and after</title>"));
}

#[test]
fn other_volumes_become_voxel_grids() {
    let desk = desk();
    let run = "clean scene:ball --cameras transforms.json --background black --points 24";
    assert_eq!(desk.good(&format!("{run} -o ball.npz")), "ball.npz\n");
    let ball = read_voxel_grid(&desk.join("ball.npz")).unwrap();
    assert_eq!(ball.shape(), [24; 3]);
    let said = desk.said(&format!("{run} -o again.npz"));
    assert!(said.contains("warning: again.npz has no place for colours that depend on the direction"), "{said}");
    let dense = ball.values().iter().filter(|value| value[3] > 1.0).count();
    assert!(dense > 200, "{dense} points of the ball");
}
