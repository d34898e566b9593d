//! The loss of an image, and its derivatives by pixels.

use glam::{DVec3, Vec3};

use crate::Shot;

/// Loss and squared error of an image, means over its pixels and channels, and the derivatives of the loss.
pub struct ImageLoss {
    pub loss: f64,
    pub squared_error: f64,
    /// `[height · width]`; 0 where pixels are masked.
    pub by_pixel: Vec<Vec3>,
}

/// The mean absolute error of an image of `shot` over a background.
pub fn loss(shot: &Shot, background: Vec3, image: &[Vec3]) -> ImageLoss {
    let over = background.as_dvec3();
    let kept = (0..image.len()).filter(|&i| shot.keeps(i)).count().max(1);
    let share = 1.0 / (3.0 * kept as f32);
    let mut of = ImageLoss { loss: 0.0, squared_error: 0.0, by_pixel: vec![Vec3::ZERO; image.len()] };
    for i in (0..image.len()).filter(|&i| shot.keeps(i)) {
        let away = image[i] - shot.image.over(i, over).as_vec3();
        of.loss += f64::from(away.abs().element_sum());
        of.squared_error += DVec3::length_squared(away.as_dvec3());
        of.by_pixel[i] = share * Vec3::select(away.cmpeq(Vec3::ZERO), Vec3::ZERO, away.signum());
    }
    of.loss /= 3.0 * kept as f64;
    of.squared_error /= 3.0 * kept as f64;
    of
}
