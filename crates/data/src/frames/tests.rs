use super::*;
use crate::write_transforms;
use octobayes::field::ClosedForm;

/// A folder with camera files of 20 frames, where only the given `images` exist.
fn split(name: &str, images: &[usize]) -> (tempfile::TempDir, FrameSplit) {
    let folder = tempfile::tempdir().unwrap();
    let cameras = ClosedForm::half_circle(20, [8, 8]).into_iter().enumerate();
    let named: Vec<_> = cameras.map(|(i, camera)| (format!("r_{i}"), camera)).collect();
    for file in ["transforms_test.json", name] {
        write_transforms(&folder.path().join(file), &named).unwrap();
    }
    for i in images {
        std::fs::write(folder.path().join(format!("r_{i}.png")), b"").unwrap();
    }
    let split = FrameSplit::new(Views::read(&folder.path().join(name), Some([8, 8])).unwrap());
    (folder, split)
}

fn names(frames: &[Frame]) -> Vec<&str> {
    frames.iter().map(|frame| frame.name.as_str()).collect()
}

#[test]
fn missing_images_are_left_out_after_frames_are_numbered_off() {
    let images: Vec<usize> = (0..20).filter(|i| ![1, 5].contains(i)).collect();
    let (folder, split) = split("transforms.json", &images);
    let select = |part, selection: &Selection| split.select(part, selection, |_| true).unwrap();
    let [training, held_out] = [Part::Training, Part::HeldOut].map(|part| select(part, &Selection::All));
    // By name, r_17 has place 9 of 20, and r_8 place 18: those that NumPy's linspace(0, 19, 18, dtype=int) skips.
    assert_eq!(names(&held_out), ["r_8", "r_17"]);
    assert_eq!((training.len(), names(&training)[3]), (16, "r_4"));
    assert_eq!(select(Part::Training, &Selection::BothParts).len(), 18);
    let three = select(Part::Training, &Selection::Count(3));
    assert_eq!(names(&three), [2, 8, 13].map(|i| names(&training)[i]));
    // Numbers are those of the file, whatever part a frame belongs to.
    for part in [Part::Training, Part::HeldOut] {
        assert_eq!(names(&select(part, &Selection::Indices(vec![0, 3, 4]))), ["r_0", "r_3", "r_4"]);
    }
    let refused = |i| split.select(Part::Training, &Selection::Indices(vec![i]), |_| true).unwrap_err().to_string();
    assert!(refused(5).contains("frame 5 (no ") && refused(20).contains("from 0 to 19, found 20"));
    assert!(split.select(Part::Training, &Selection::Count(17), |_| true).is_err());

    let path = folder.path().display();
    let start = format!("of 20 frames of {path}/transforms.json: 2 have no image ({path}/r_1.png, r_5.png)");
    let held = "2 are held out, a tenth, as nerfstudio does: 8 (r_8), 17 (r_17) (views `all` takes both)";
    assert_eq!(split.describe(Part::Training, &training), format!("16 cameras {start}, {held}"));
    assert_eq!(
        split.describe(Part::Training, &three),
        format!("3 cameras {start}, {held}, 13 not chosen; used are frames 3, 11, 16")
    );
    let both = select(Part::Training, &Selection::BothParts);
    assert_eq!(split.describe(Part::Training, &both), format!("18 cameras {start}"));
    let judged = split.describe(Part::HeldOut, &held_out);
    let those = "held out, a tenth, as nerfstudio does: 8 (r_8), 17 (r_17)";
    assert_eq!(judged, format!("2 cameras {start}, 16 are for training (views `all` takes both); {those}"));
}

/// A model of COLMAP whose pictures have these names.
fn colmap(names: &[String]) -> (tempfile::TempDir, FrameSplit) {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("cameras.txt", "1 SIMPLE_PINHOLE 8 8 8 4 4\n");
    let images = names.iter().enumerate().map(|(i, name)| {
        write(name, "");
        format!("{} 1 0 0 0 0 0 {i} 1 {name}\n\n", i + 1)
    });
    write("images.txt", &images.collect::<String>());
    let split = FrameSplit::new(Views::read(folder.path(), None).unwrap());
    (folder, split)
}

fn held_out(split: &FrameSplit) -> Vec<String> {
    split.of(Purpose::HeldOut).into_iter().map(|frame| frame.name.clone()).collect()
}

#[test]
fn of_colmap_models_those_are_held_out_that_gaussian_splatting_tests_on() {
    // As the original code: sorted by name as text, each whose place 8 divides.
    let mut shuffled: Vec<String> = (0..18).map(|i| format!("img{}.png", (i * 7) % 18)).collect();
    let (folder, split) = colmap(&shuffled);
    assert_eq!(held_out(&split), ["img0.png", "img16.png", "img8.png"]);
    let training = split.select(Part::Training, &Selection::All, |_| true).unwrap();
    let said = split.describe(Part::Training, &training);
    let numbers = "and gsplat: 0 (img0.png), 8 (img16.png), 16 (img8.png) (views `all` takes both)";
    assert!(said.contains("3 are held out, every eighth by name") && said.contains(numbers), "{said}");
    // A picture that went missing since does not move the others.
    for gone in ["img1.png", "img0.png"] {
        std::fs::remove_file(folder.path().join(gone)).unwrap();
    }
    let split = FrameSplit::new(Views::read(folder.path(), None).unwrap());
    assert_eq!(held_out(&split), ["img16.png", "img8.png"]);
    shuffled.truncate(2);
    assert_eq!(held_out(&colmap(&shuffled).1), [""; 0], "two are for training");
}

#[test]
fn of_other_files_those_are_held_out_that_nerfstudio_tests_on() {
    // numpy.setdiff1d(numpy.arange(n), numpy.linspace(0, n - 1, math.ceil(0.9 * n), dtype=int))
    for (count, places) in
        [(1, vec![]), (9, vec![]), (10, vec![8]), (16, vec![14]), (30, vec![9, 19, 28]), (50, vec![9, 19, 29, 39, 48])]
    {
        assert_eq!(Rule::Tenth.held_out(count), places, "{count}");
    }
}

#[test]
fn the_cameras_of_the_model_decide_before_any_rule() {
    let (_folder, split) = split("transforms.json", &(0..20).collect::<Vec<usize>>());
    let split = split.by_model(|frame| frame.index < 18);
    assert_eq!(held_out(&split), ["r_18", "r_19"]);
    assert_eq!(held_out(&split.by_model(|_| false)), ["r_18", "r_19"], "another model's cameras say nothing");
}

#[test]
fn what_the_file_says_of_its_frames_decides() {
    let all: Vec<usize> = (0..20).collect();
    let (folder, _) = split("transforms.json", &all);
    let path = folder.path().join("transforms.json");
    let mut file: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    let list =
        |range: std::ops::Range<usize>| -> Vec<serde_json::Value> { range.map(|i| format!("r_{i}").into()).collect() };
    file["train_filenames"] = list(0..8).into();
    file["test_filenames"] = list(8..11).into();
    std::fs::write(&path, file.to_string()).unwrap();
    let split = FrameSplit::new(Views::read(&path, Some([8, 8])).unwrap());
    let select = |part, selection: &Selection| split.select(part, selection, |_| true).unwrap();
    let [training, held_out] = [Part::Training, Part::HeldOut].map(|part| select(part, &Selection::All));
    assert_eq!((training.len(), names(&held_out)), (8, vec!["r_8", "r_9", "r_10"]));
    assert_eq!(
        split.describe(Part::Training, &training),
        format!(
            "8 cameras of 20 frames of {}: 3 are held out, by the file: 8 (r_8), 9 (r_9), 10 (r_10) (views \
             `all` takes both), 9 are in neither part",
            path.display()
        )
    );
    assert_eq!(select(Part::Training, &Selection::BothParts).len(), 20);
    assert_eq!(names(&select(Part::Training, &Selection::Indices(vec![15]))), ["r_15"]);
}

#[test]
fn a_file_that_leaves_no_frame_is_refused() {
    let (folder, _) = split("transforms.json", &(0..20).collect::<Vec<usize>>());
    let path = folder.path().join("transforms.json");
    let mut file: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    file["n_frames"] = 0.into();
    std::fs::write(&path, file.to_string()).unwrap();
    let split = FrameSplit::new(Views::read(&path, Some([8, 8])).unwrap());
    for part in [Part::Training, Part::HeldOut] {
        let error = split.select(part, &Selection::All, |_| true).unwrap_err().to_string();
        assert!(error.contains("frames: expected frames that are") && error.ends_with("found none of 20"), "{error}");
        assert_eq!(split.matching(part, &Selection::All, |_| true).unwrap(), []);
    }
    assert_eq!(split.select(Part::HeldOut, &Selection::BothParts, |_| true).unwrap().len(), 20);
}

#[test]
fn files_that_say_what_they_are_for_are_not_split() {
    let all: Vec<usize> = (0..20).collect();
    for name in ["transforms_train.json", "transforms_test.json", "transforms_val.json"] {
        let (_folder, split) = split(name, &all);
        assert_eq!(split.without_training().is_some(), name != "transforms_train.json", "{name}");
        for part in [Part::Training, Part::HeldOut] {
            assert_eq!(split.select(part, &Selection::All, |_| true).unwrap().len(), 20, "{name}");
        }
    }
    // Without any image it is a file of cameras.
    let (folder, split) = split("transforms.json", &[]);
    assert!(!split.has_images() && split.missing() == 0);
    let frames = split.select(Part::Training, &Selection::All, |_| true).unwrap();
    assert_eq!(frames.len(), 20);
    let path = folder.path().display();
    let said = format!(
        "no image is there, such as {path}/r_0.png, so that no frame is held out, though training may have held \
         out 8 (r_8), 17 (r_17)"
    );
    let expected = format!("20 cameras of 20 frames of {path}/transforms.json: {said}");
    assert_eq!(split.describe(Part::Training, &frames), expected);
}
