//! The figures of README and of the book are those of the reports: the sentences are made again from the tables.

use std::path::Path;

use crate::common::report;
use crate::common::table::whole;

const README: &str = "README.md";
const RESULTS: &str = "docs/src/results.md";
const EVALUATE: &str = "docs/src/evaluate.md";
const CONCEPTS: &str = "docs/src/concepts.md";
const LARGE: &str = "docs/src/large-scenes.md";
const FEW: &str = "docs/src/few-rays.md";

/// Where a table stands: report, block, and a part of the heading or title above it in the block, which may be empty.
type Place = [&'static str; 3];

const AGREEMENT: Place = ["lego", "agreement", ""];
const RAYS: Place = ["speed_vs_error", "rays", ""];
const TARGETS: Place = ["speed_vs_error", "targets", ""];
const PROFILE: Place = ["speed_vs_error", "profile", ""];
const BUDGET: Place = ["scaling", "budget", ""];
const MESHES: Place = ["depth", "meshes", "Ranking"];
const STRONG: Place = ["depth", "strong", "Ranking"];
const ENSEMBLES: Place = ["depth", "ensembles", "Ranking"];
const FOX: Place = ["photographs", "fox", ""];

/// The first number of a cell, in another unit, to so many digits.
#[derive(Clone)]
struct Figure {
    place: Place,
    /// A part of the one row that is meant.
    row: &'static str,
    /// The column's title; `→` stands for the next column.
    column: &'static str,
    unit: f64,
    /// `None`: as it stands in the report.
    digits: Option<usize>,
}

fn figure(place: Place, row: &'static str, column: &'static str) -> Figure {
    Figure { place, row, column, unit: 1.0, digits: None }
}

impl Figure {
    fn in_units(self, unit: f64, digits: usize) -> Self {
        Self { unit, digits: Some(digits), ..self }
    }

    fn rounded(self, digits: usize) -> Self {
        self.in_units(1.0, digits)
    }

    fn text(&self) -> String {
        let found = cell(self.place, self.row, self.column);
        let number = found.split(' ').next().unwrap_or_default();
        let Some(digits) = self.digits else { return number.into() };
        let value: f64 = number.replace(',', "").parse().unwrap_or_else(|_| panic!("{number} of {found}"));
        let value = value / self.unit;
        if digits == 0 { whole(value) } else { format!("{value:.digits$}") }
    }
}

fn read(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The cell of a report's table. It must be the only one of that row and column.
fn cell([report, block, section]: Place, row: &str, column: &str) -> String {
    let text = read(&format!("experiments/{report}.md"));
    let blocks = report::blocks(&text).unwrap_or_else(|fault| panic!("{report}: {fault:?}"));
    let body = blocks.iter().find(|found| found.name == block).unwrap_or_else(|| panic!("{report}: {block}")).body;
    let (mut heading, mut head, mut found) = ("", Vec::new(), Vec::new());
    for line in body.lines() {
        if line.starts_with("### ") || line.starts_with("**") {
            heading = line;
        } else if !line.starts_with('|') {
            head.clear();
        } else if head.is_empty() {
            head = cells(line);
        } else if heading.contains(section) && line.contains(row) {
            let column = (column.trim_end_matches('→'), column.matches('→').count());
            let index = head.iter().position(|title| *title == column.0);
            found.extend(index.map(|index| cells(line)[index + column.1].to_owned()));
        }
    }
    assert_eq!(found.len(), 1, "{report}, {block}, {section}: cells of row `{row}`, column `{column}`: {found:?}");
    found.remove(0)
}

fn cells(line: &str) -> Vec<&str> {
    line.trim().trim_matches('|').split(" | ").map(str::trim).collect()
}

/// Whether a page says the sentence, each `{}` of it filled with a figure; otherwise what it should say.
fn check(page: &str, sentence: &str, figures: &[Figure]) -> Result<(), String> {
    let parts: Vec<&str> = sentence.split("{}").collect();
    assert_eq!(parts.len(), figures.len() + 1, "{sentence}");
    let filled = parts[1..].iter().zip(figures).map(|(part, figure)| figure.text() + part);
    let expected = parts[0].to_owned() + &filled.collect::<String>();
    let words: Vec<&str> = page.split_whitespace().collect();
    if words.join(" ").contains(&expected) { Ok(()) } else { Err(expected) }
}

/// Coverage of the intervals for 68, 90 and 95 %, without and with `--images`.
fn coverage(block: &'static str, heading: &'static str) -> Vec<Figure> {
    let of = |row| ["68 %", "90 %", "95 %"].map(|column| figure(["depth", block, heading], row, column).rounded(0));
    [of("| 0 |"), of("(`--images`")].into_iter().flatten().collect()
}

/// Coverage of the interval for 90 %, with `--images`.
fn with_images(block: &'static str, heading: &'static str) -> Figure {
    figure(["depth", block, heading], "(`--images`", "90 %").rounded(0)
}

/// Sentences of pages with the figures in them.
fn sentences() -> Vec<(&'static str, &'static str, Vec<Figure>)> {
    let of = |row, column| figure(AGREEMENT, row, column);
    let mega = |row, column, digits| of(row, column).in_units(1e6, digits);
    let lego = |row, column| figure(RAYS, row, column);
    let time = |row| figure(TARGETS, row, "s, median of 3").rounded(0);
    let plain = |row| figure(PROFILE, row, "times plain rendering");
    let city = |row, column, unit, digits| figure(BUDGET, row, column).in_units(unit, digits);
    let (field, peak, dense) = ("field for queries, bytes", "peak of the process, MB", "dense f32 grid, bytes");
    let (low, zero, grid) = ("| octree, tolerance 0.01 |", "| octree, tolerance 0 |", "| dense |");
    let (boxed, zero_box, surfaces) =
        ("| octree, tolerance 0.01, box |", "| octree, tolerance 0, box |", "| octree, tolerance 0.01, surfaces |");
    let (queries, sums) = ("bytes for queries", "sums while running, MB");
    let (ours, control, variance) =
        ("| block 6, u-spread-per-root-ray |", "| weights' spread / rays |", "| ray-weight variance |");
    let tested = |row, column| figure(MESHES, row, column);
    let (mae, rmse) = ("tested on: MAE", "tested on: MAE→");
    let strong = |row, column| figure(STRONG, row, column);
    let first = |row, column| figure(ENSEMBLES, row, column);
    let ensemble = "| ensemble depth variance |";
    let [own_01, own_04, own_1, own_4] = [
        "| lego, Plenoptic PNG | 102,400 | octree, own derivatives |",
        "| lego, Plenoptic PNG | 409,600 | octree, own derivatives |",
        "| lego, Plenoptic PNG | 1,024,000 | octree, own derivatives |",
        "| lego, Plenoptic PNG | 4,096,000 | octree, own derivatives |",
    ];
    let scenes = |row| figure(["speed_vs_error", "scenes", ""], row, "s, median");
    let pooled = "| lego, Plenoptic PNG | 102,400 | own, `--pooling auto` |";
    let (took, error) = ("s, median", "surfaces: mean");
    let [l12, l13] = ["| 12 | 4096 | 4,096,000 | no |", "| 13 | 8192 | 4,096,000 | no |"];
    let fox = |row| figure(FOX, row, "rank correlation with the error of colours");
    let [fox_12, fox_44] = ["| 12 | log10 U, weighted-mean |", "| 44 | log10 U, weighted-mean |"];
    let [angle_12, angle_44] = ["| 12 | angle", "| 44 | angle"];
    let weight = "By the weight of the residuals";
    let limited = |block, row| {
        let of = |column, digits| figure(["criteria", block, ""], row, column).rounded(digits);
        [("surfaces: mean", 3), ("surfaces: mean→→", 2)].map(|(column, digits)| of(column, digits))
    };
    let [four, sixteen] = ["| sensitivity, ray-count | 0.01 | 4 |", "| sensitivity, ray-count | 0.01 | 16 |"];
    let hardly = |block, column| figure(["criteria", block, ""], four, column);
    let next = |row| figure(["next_view", "strategies", "error of depth"], row, "mean").rounded(3);
    let ten = || coverage("meshes", "scenes that have no say");
    vec![
        (
            README,
            "lego at 256³: {} MB instead of {} MB; log10 U differs by up to about {} |",
            vec![mega(low, queries, 2), mega(grid, queries, 1), of(boxed, "max").rounded(3)],
        ),
        (README, "| an object: lego, Plenoptic PNG | {} s |", vec![lego(own_01, took).rounded(1)]),
        (
            README,
            "| photographs of unbounded space: garden, Plenoptic PNG | {} s |",
            vec![scenes("| garden (unbounded) | 102,400 | octree, own").rounded(0)],
        ),
        (
            README,
            "log10 U on surfaces is off by {} with 102,400 rays and `--pooling auto`, by {} with four million |",
            vec![lego(pooled, error).rounded(2), lego(own_4, error).rounded(2)],
        ),
        (
            README,
            "a city at 8192³: {} MB instead of {} TB, within 4 GiB",
            vec![city(l13, field, 1e6, 0), city(l13, dense, 1e12, 1)],
        ),
        (
            README,
            "AUSE on ten scenes (0 is perfect): {} with U, {} without, by the weights of a ray and its number of rays",
            vec![tested(ours, mae), tested(control, mae)],
        ),
        (README, "six scenes: {} by `next-view`, {} at random |", ["| log det |", "| random |"].map(next).into()),
        (
            README,
            "with `--images`, nominal 90 % covers {} % on held-out scenes of four meshes, {} % on lego; not measured",
            vec![with_images("meshes", "scenes that have no say"), with_images("lego", weight)],
        ),
        (EVALUATE, "four ray-traced meshes; 1000 steps, three seeds | {}, {}, {} | {}, {}, {} |", ten()),
        (EVALUATE, "the same, 6000 steps; three seeds | {}, {}, {} | {}, {}, {} |", coverage("strong", weight)),
        (EVALUATE, "a knot; two scenes, three seeds | {}, {}, {} | {}, {}, {} |", coverage("built-in", weight)),
        (EVALUATE, "four scenes, three seeds | {}, {}, {} | {}, {}, {} |", coverage("lego", weight)),
        (CONCEPTS, "is {} with 12 training views and {} with 44", vec![fox(fox_12), fox(fox_44)]),
        (CONCEPTS, "which needs no model, has {} and {}.", vec![fox(angle_12), fox(angle_44)]),
        (
            LARGE,
            "| courtyard | 4 | {} | {} | | courtyard | 16 | {} | {} |",
            [
                [hardly("courtyard", "surfaces: mean"), hardly("courtyard", "surfaces: mean→→")],
                limited("courtyard", sixteen),
            ]
            .concat(),
        ),
        (
            LARGE,
            "| lego | 4 | {} | {} | | lego | 16 | {} | {} |",
            [
                [hardly("lego", "surfaces: mean"), hardly("lego", "surfaces: mean→→").rounded(2)],
                limited("lego", sixteen),
            ]
            .concat(),
        ),
        (
            FEW,
            "| 409,600 | {} | | a million | {} | | four million | {} |",
            [own_04, own_1, own_4].map(|row| lego(row, error).rounded(2)).into(),
        ),
        (
            RESULTS,
            "| dense, 257³ | {} | {} MB | {} MB |",
            vec![of(grid, "vertices"), mega(grid, queries, 1), of(grid, sums).rounded(0)],
        ),
        (
            RESULTS,
            "| octree, tolerance 0.01 | {} | {} MB ({} MB structure), 1 : {} | {} MB | {} (mean {}) | {} |",
            vec![
                of(low, "vertices"),
                mega(low, queries, 2),
                mega(low, "structure, bytes", 2),
                of(low, "dense : this"),
                of(low, sums),
                of(boxed, "max"),
                of(boxed, "mean"),
                of(surfaces, "max"),
            ],
        ),
        (
            RESULTS,
            "| octree, tolerance 0 | {} | {} MB, 1 : {} | {} MB | 0 (mean {}) | 0 |",
            vec![
                of(zero, "vertices"),
                mega(zero, queries, 2),
                of(zero, "dense : this"),
                of(zero, sums),
                of(zero_box, "mean"),
            ],
        ),
        (RESULTS, "| the model's own | {} s | {} |", vec![time("Analytic"), plain("| own derivatives |")]),
        (
            RESULTS,
            "| forward differences | {} s | {} |",
            vec![time("ForwardDifference"), plain("| forward differences |")],
        ),
        (RESULTS, "| central differences | {} s | {} |", vec![time("| FiniteDifference"), plain("| differences |")]),
        (
            RESULTS,
            "| 102,400, `--pooling auto` | {} | {} s | | 409,600 | {} | {} s | | 1,024,000 | {} | {} s | \
             | 4,096,000 | {} |",
            vec![
                lego(pooled, error).rounded(2),
                lego(pooled, took).rounded(1),
                lego(own_04, error).rounded(2),
                lego(own_04, took).rounded(2),
                lego(own_1, error).rounded(2),
                lego(own_1, took).rounded(2),
                lego(own_4, error).rounded(2),
            ],
        ),
        (
            RESULTS,
            "| 4096³ | {} GB | {} MB | {} GB | | 8192³ | {} GB | {} MB | {} TB |",
            vec![
                city(l12, peak, 1e3, 1),
                city(l12, field, 1e6, 0),
                city(l12, dense, 1e9, 0),
                city(l13, peak, 1e3, 1),
                city(l13, field, 1e6, 0),
                city(l13, dense, 1e12, 1),
            ],
        ),
        (
            RESULTS,
            "(default of `evaluate`), `block`, level 6 | {} | {} | | variance of the ray's weights | {} | {} | | U at \
             the expected depth alone | {} | {} | | s / n, a control without a Hessian | {} | {} |",
            vec![
                tested(ours, mae),
                tested(ours, rmse),
                tested(variance, mae),
                tested(variance, rmse),
                tested("| block 6, at-expected |", mae),
                tested("| block 6, at-expected |", rmse),
                tested(control, mae),
                tested(control, rmse),
            ],
        ),
        (
            RESULTS,
            "| U s / √n | {} | {} | | ensemble of ten | {} | {} |",
            vec![first(ours, "MAE"), first(ours, "RMSE"), first(ensemble, "MAE"), first(ensemble, "RMSE")],
        ),
        (
            RESULTS,
            "| U s / √n | {} | {} | | s / n | {} | {} |",
            vec![strong(ours, "MAE"), strong(ours, "RMSE"), strong(control, "MAE"), strong(control, "RMSE")],
        ),
    ]
}

#[test]
fn pages_say_what_the_reports_say() {
    let wrong: Vec<String> = sentences()
        .into_iter()
        .filter_map(|(page, sentence, figures)| {
            let expected = check(&read(page), sentence, &figures).err()?;
            Some(format!("{page}: expected `{expected}`"))
        })
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn another_figure_is_noticed() {
    let place = figure(AGREEMENT, "| dense |", "bytes for queries").in_units(1e6, 1);
    let page = "3.80 MB in\n  memory instead of 67.9 MB.";
    let expected = check(page, "memory instead of {} MB.", &[place]).unwrap_err();
    assert_eq!(expected, "memory instead of 84.9 MB.");
}
