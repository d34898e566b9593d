//! Tests of all scenes, and of the city against its definition.

use std::sync::LazyLock;

use glam::Vec3;
use proptest::prelude::*;

use super::*;

static SCENES: LazyLock<Vec<ClosedForm>> =
    LazyLock::new(|| ClosedForm::NAMES.iter().map(|name| ClosedForm::named(name).unwrap()).collect());
static CITY: LazyLock<ClosedForm> = LazyLock::new(|| ClosedForm::named("city-5").unwrap());

fn at(field: &ClosedForm, x: Vec3) -> Radiance {
    let mut out = [Radiance::default()];
    field.evaluate(&[x], &[Vec3::Z], &mut out);
    out[0]
}

/// The point at `unit` in `[0, 1]`³ of a scene's box.
fn within(bounds: &Aabb, unit: Vec3) -> Vec3 {
    bounds.clamp((bounds.min() + unit.as_dvec3() * bounds.size()).as_vec3())
}

#[test]
fn slab_is_homogeneous_inside_and_empty_outside() {
    let slab = ClosedForm::slab(4.0);
    assert_eq!(at(&slab, Vec3::new(0.49, 0.9, 0.0)).density, 4.0);
    assert_eq!(at(&slab, Vec3::new(0.51, 0.9, 0.0)).density, 0.0);
    assert_eq!(at(&slab, Vec3::new(0.0, 1.1, 0.0)).density, 0.0, "outside the box");
}

#[test]
fn all_scenes_are_valid_everywhere_and_not_empty() {
    for name in ClosedForm::NAMES {
        let field = ClosedForm::named(name).unwrap();
        let mut largest = 0.0_f32;
        for i in 0..17 * 17 * 17 {
            let unit = Vec3::new((i % 17) as f32, (i / 17 % 17) as f32, (i / 289) as f32) / 16.0;
            let value = at(&field, within(&field.bounds, unit));
            assert!(value.is_valid() && value.color.min_element() >= 0.0 && value.color.max_element() <= 1.0);
            largest = largest.max(value.density);
        }
        assert!(largest > 1.0, "{name} has density");
    }
    for name in ["teapot", "city-", "city--1", "city-x"] {
        assert!(ClosedForm::named(name).is_err(), "{name}");
    }
}

#[test]
fn a_city_is_its_seed() {
    let city = |name| ClosedForm::named(name).unwrap();
    assert_eq!(city("city"), city("city-0"));
    assert_ne!(city("city").primitives, city("city-1").primitives);
    // Figures are reported for this city. It may change only on purpose, and must not depend on the platform.
    assert_eq!(crc32fast::hash(format!("{:?}", city("city").primitives).as_bytes()), 3_027_789_705);
}

#[test]
fn cameras_see_the_scene_from_outside_of_its_matter() {
    for name in ClosedForm::NAMES {
        let field = ClosedForm::named(name).unwrap();
        let cameras = field.cameras(&Intrinsics::default()).unwrap().unwrap();
        assert_eq!(cameras.len(), if name == "city" { 800 } else { 40 });
        for camera in &cameras {
            // In the city, there is no matter even within a metre.
            let near = field.bounds.size() / 512.0;
            let bound = field.density_bound((camera.position - near).as_vec3(), (camera.position + near).as_vec3());
            assert_eq!(bound, Some(0.0), "{name} at {}", camera.position);
        }
    }
    let loose = ClosedForm::new("loose", Vec::new(), Aabb::centered_cube(1.0), 0.1);
    assert!(loose.cameras(&Intrinsics::default()).unwrap().is_none());
}

#[test]
fn most_of_the_citys_air_is_known_to_be_empty() {
    let city = ClosedForm::named("city").unwrap();
    // The air above the roofs is known to be empty, and so are boxes of 4 m in streets and yards. Buildings
    // and ground fill less than a sixth of the cube.
    assert_eq!(city.density_bound(Vec3::new(0.0, 0.0, 62.0), Vec3::new(512.0, 512.0, 496.0)), Some(0.0));
    let boxes = |z: f32| {
        (0..128 * 128).filter(move |i| {
            let min = 4.0 * Vec3::new((i / 128) as f32, (i % 128) as f32, 0.25 * z);
            city.density_bound(min, min + 4.0) == Some(0.0)
        })
    };
    assert_eq!(boxes.clone()(-2.0).count(), 0, "the ground is everywhere");
    assert!(boxes(8.0).count() > 4000, "streets and yards");
}

proptest! {
    #[test]
    fn columns_give_the_sum_over_all_primitives(unit in [0.0..1.0_f32, 0.0..1.0, 0.0..0.2], edge in 0u32..65) {
        let mut x = within(&CITY.bounds, Vec3::from_array(unit));
        // Half of the points lie on the border of a column.
        if edge % 2 == 0 {
            x.x = 8.0 * edge as f32;
        }
        prop_assert_eq!(at(&CITY, x), ClosedForm::sum(x, &CITY.primitives));
    }

    #[test]
    fn bounds_hold_in_random_boxes(
        scene in 0..ClosedForm::NAMES.len(),
        low in [0.0..1.0_f32, 0.0..1.0, 0.0..0.2],
        size in prop_oneof![1e-4..0.01_f32, 0.01..0.3_f32],
        inside in proptest::collection::vec([0.0..1.0_f32, 0.0..1.0, 0.0..1.0], 64),
    ) {
        let field = &SCENES[scene];
        let low = Vec3::from_array(low);
        let (min, max) = (within(&field.bounds, low), within(&field.bounds, low + size));
        let bound = field.density_bound(min, max).unwrap();
        for x in inside {
            let x = (min + Vec3::from_array(x) * (max - min)).clamp(min, max);
            prop_assert!(at(field, x).density <= bound, "{} above {} at {}", at(field, x).density, bound, x);
        }
    }
}
