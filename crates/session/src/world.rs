//! Whether splats lie in another frame than the cameras: that of their training program, as their export has it.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use octobayes::Result;
use octobayes::metrics::median;
use octobayes_data::{Views, frame_beside, frames_of_training};

/// Most points of a COLMAP model, and most splats, that are compared.
const POINTS: usize = 512;
/// See [`POINTS`].
const SPLATS: usize = 100_000;
/// Points lie near splats that grew from them: within this share of their own spread.
const NEAR_SHARE: f64 = 0.03;
/// Another frame must fit so many times better than their own.
const BETTER: f64 = 4.0;

/// In words, the frame in which the splats probably lie, if it is not that of the cameras: the COLMAP points, from
/// which splats grow, lie near them there alone; or nerfstudio left the frame's file beside the cameras.
///
/// # Errors
/// If a COLMAP model cannot be read.
pub fn other_frame(centers: &[Vec3], views: &Views) -> Result<Option<String>> {
    if centers.is_empty() {
        return Ok(None);
    }
    let (frames, points) = frames_of_training(&views.path)?;
    let misfit = |frame: &octobayes_data::Similarity| {
        let placed: Vec<DVec3> = every(&points, POINTS).map(|point| frame.point(*point)).collect();
        let middle = placed.iter().sum::<DVec3>() / placed.len() as f64;
        let spread = median(placed.iter().map(|point| point.distance(middle)));
        let some: Vec<Vec3> = every(centers, SPLATS).copied().collect();
        let nearest = |point: &DVec3| {
            let point = point.as_vec3();
            f64::from(some.iter().map(|mean| mean.distance_squared(point)).fold(f32::INFINITY, f32::min).sqrt())
        };
        median(placed.par_iter().map(nearest).collect::<Vec<f64>>()) / spread.max(f64::MIN_POSITIVE)
    };
    let misfits: Vec<f64> = frames.iter().map(|(_, frame)| misfit(frame)).collect();
    let best = (1..misfits.len()).min_by(|&a, &b| misfits[a].total_cmp(&misfits[b]));
    if let Some(best) = best.filter(|&best| misfits[best] < NEAR_SHARE && misfits[best] * BETTER < misfits[0]) {
        let ((name, frame), times) = (&frames[best], misfits[0] / misfits[best]);
        let folder = if views.path.is_dir() { Some(views.path.as_path()) } else { views.path.parent() };
        let file = folder.unwrap_or(std::path::Path::new("")).join("dataparser_transforms.json");
        return Ok(Some(format!(
            "splats in another frame than the cameras, {name}: there COLMAP's points lie {times:.0} times nearer to \
             them; write {} to {} and pass that as --cameras",
            frame.to_json(),
            file.display()
        )));
    }
    // If the points fit as they are, the file is probably of something else.
    let fits = misfits.first().is_some_and(|own| *own < NEAR_SHARE);
    Ok(frame_beside(&views.path).filter(|_| !fits).map(|file| {
        format!(
            "splats in nerfstudio's frame, as `ns-export gaussian-splat` writes them, and cameras in the data set's: \
             pass {} as --cameras, which moves them",
            file.display()
        )
    }))
}

/// At most `count` of a list, spread over it.
fn every<T>(list: &[T], count: usize) -> impl Iterator<Item = &T> {
    list.iter().step_by(list.len().div_ceil(count).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use octobayes_data::Similarity;

    /// A model of COLMAP in a new folder, with points in a slab that no turn maps onto itself.
    fn colmap() -> (tempfile::TempDir, Views) {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
        write("cameras.txt", "1 SIMPLE_PINHOLE 8 8 8 4 4\n".into());
        let image = |i: u32| format!("{i} 1 0 0 0 {} {} {} 1 {i}.png\n\n", i % 3, i % 2, 4 + i % 5);
        write("images.txt", (1..8).map(image).collect());
        let point = |i: u32| {
            let share = |prime: f64| (f64::from(i) * prime.sqrt()).fract();
            let [x, y, z] = [3.0 * share(2.0).powi(2), share(3.0), 0.4 * share(5.0).powi(3)];
            format!("{i} {x} {y} {z} 9 9 9 0.1\n")
        };
        write("points3D.txt", (1..200).map(point).collect());
        let views = Views::read(folder.path(), None).unwrap();
        (folder, views)
    }

    fn splats(points: &[DVec3], frame: &Similarity) -> Vec<Vec3> {
        points.iter().map(|point| frame.point(*point).as_vec3()).collect()
    }

    #[test]
    fn splats_in_the_frame_of_their_training_are_known_by_the_points_of_colmap() {
        let (_folder, views) = colmap();
        let (frames, points) = frames_of_training(&views.path).unwrap();
        assert_eq!(other_frame(&splats(&points, &frames[0].1), &views).unwrap(), None, "their own frame");
        for (name, frame) in &frames[1..] {
            let found = other_frame(&splats(&points, frame), &views).unwrap().unwrap();
            assert!(found.contains(name) && found.contains(&frame.to_json()), "{found}");
        }
        // The file that the message names is read, and moves the cameras there.
        let file = views.path.join("dataparser_transforms.json");
        std::fs::write(&file, frames[3].1.to_json()).unwrap();
        let moved = Views::read(&file, None).unwrap();
        let expected = frames[3].1.camera(&views.frames[2].camera).position;
        assert!(moved.frames[2].camera.position.distance(expected) < 1e-6);
        assert_eq!(other_frame(&splats(&points, &frames[3].1), &moved).unwrap(), None);
        // Splats in the frame of the cameras, whatever file lies there.
        assert_eq!(other_frame(&splats(&points, &frames[0].1), &views).unwrap(), None);
    }

    #[test]
    fn a_run_of_nerfstudio_beside_the_cameras_is_told() {
        let (folder, _) = colmap();
        std::fs::remove_file(folder.path().join("points3D.txt")).unwrap();
        let views = Views::read(folder.path(), None).unwrap();
        let splats = splats(&[DVec3::ZERO], &Similarity::IDENTITY);
        assert_eq!(other_frame(&splats, &views).unwrap(), None);
        let file = folder.path().join("dataparser_transforms.json");
        std::fs::write(&file, Similarity::IDENTITY.to_json()).unwrap();
        let found = other_frame(&splats, &views).unwrap().unwrap();
        assert!(found.contains(&format!("pass {} as --cameras", file.display())), "{found}");
        assert_eq!(other_frame(&splats, &Views::read(&file, None).unwrap()).unwrap(), None);
    }
}
