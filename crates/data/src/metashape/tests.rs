use octobayes::geometry::Camera;

use super::*;
use crate::Views;

/// A file as Metashape writes it: a chunk with a similarity, three cameras of one sensor, the last not aligned.
fn file(calibration: &str, more: &str) -> String {
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
  <chunk label="Chunk 1" enabled="true">
    <sensors next_id="1">
      <sensor id="0" label="X-T3" type="frame">
        <resolution width="60" height="40"/>
        <property name="layer_index" value="0"/>
        <calibration type="frame" class="initial"><resolution width="60" height="40"/><f>1</f></calibration>
        <calibration type="frame" class="adjusted">
          <resolution width="60" height="40"/>{calibration}
        </calibration>
        <covariance><params>f cx</params><coeffs>1 0 0 1</coeffs></covariance>
      </sensor>
    </sensors>
    <components next_id="1" active_id="0">{more}</components>
    <cameras next_id="3" next_group_id="1">
      <camera id="0" sensor_id="0" component_id="0" label="IMG_1.JPG">
        <transform>1 0 0 1 0 1 0 2 0 0 1 3 0 0 0 1</transform>
        <rotation_covariance>0 0 0 0 0 0 0 0 0</rotation_covariance>
      </camera>
      <group id="0" label="walk">
        <camera id="1" sensor_id="0" component_id="0" label="IMG_2">
          <transform>0 0 1 0 -1 0 0 0 0 -1 0 0 0 0 0 1</transform>
        </camera>
      </group>
      <camera id="2" sensor_id="0" label="IMG_3"/>
    </cameras>
    <transform>
      <rotation locked="true">0 -1 0 1 0 0 0 0 1</rotation>
      <translation locked="true">10 20 30</translation>
      <scale locked="true">2</scale>
    </transform>
  </chunk>
</document>
"#
    )
}

const LENS: &str = "<f>50</f><cx>1.5</cx><cy>-2</cy><b1>0.5</b1><k1>0.01</k1><k2>-0.02</k2><k3>0.003</k3><p1>0.001</p1>\
                    <p2>-0.002</p2>";

fn read(text: &str) -> Result<Views> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.xml");
    std::fs::write(&path, text).unwrap();
    Views::read(&path, None)
}

#[test]
fn poses_are_in_the_world_and_lenses_are_metashape_s() {
    let views = read(&file(LENS, "")).unwrap();
    assert!(views.notes.iter().any(|note| note.contains("1 of 3 cameras are not aligned")), "{:?}", views.notes);
    let [first, second] = &views.frames[..] else { panic!("{:?}", views.frames) };
    assert_eq!((first.name.as_str(), second.name.as_str()), ("IMG_1.JPG", "IMG_2"));
    // x_world = 2 R x + t, where R turns x to y.
    assert!(first.camera.position.distance(DVec3::new(10.0 - 4.0, 20.0 + 2.0, 30.0 + 6.0)) < 1e-12);
    // The first camera looks along the chunk's z with its x to the right, which becomes the world's y.
    let Camera { axes, .. } = first.camera;
    assert!(axes.x_axis.distance(DVec3::Y) < 1e-12 && (-axes.z_axis).distance(DVec3::Z) < 1e-12, "{axes}");
    // The second looks along the chunk's x, the world's y, with the chunk's z up.
    let Camera { axes, .. } = second.camera;
    assert!((-axes.z_axis).distance(DVec3::Y) < 1e-12 && axes.y_axis.distance(DVec3::Z) < 1e-12, "{axes}");
    // A point in front of the first, projected by the formulas of the manual.
    let (x, y): (f64, f64) = (0.2, -0.1);
    let r2 = x * x + y * y;
    let radial = 1.0 + 0.01 * r2 - 0.02 * r2 * r2 + 0.003 * r2 * r2 * r2;
    let (p1, p2) = (0.001, -0.002);
    let bent = [
        x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y,
        y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y,
    ];
    let expected = [30.0 + 1.5 + 50.5 * bent[0], 20.0 - 2.0 + 50.0 * bent[1]];
    let camera = first.camera;
    let seen = camera.position + 3.0 * (x * camera.axes.x_axis - y * camera.axes.y_axis - camera.axes.z_axis);
    let (at, _) = camera.project_inside(seen).unwrap();
    assert!((at[0] - expected[0]).abs() < 1e-9 && (at[1] - expected[1]).abs() < 1e-9, "{at:?} {expected:?}");
    assert_eq!(camera.resolution, [60, 40]);
}

#[test]
fn a_component_has_its_own_transform() {
    let component = "<component id=\"0\"><transform><translation>0 0 5</translation></transform></component>";
    let views = read(&file(LENS, component)).unwrap();
    assert!(views.frames[0].camera.position.distance(DVec3::new(1.0, 2.0, 8.0)) < 1e-12);
}

#[test]
fn images_are_found_by_their_labels() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    std::fs::write(folder.path().join("cameras.xml"), file(LENS, "")).unwrap();
    for name in ["images/IMG_1.JPG", "images/IMG_2.jpg"] {
        image::RgbImage::new(60, 40).save(folder.path().join(name)).unwrap();
    }
    let views = Views::read(&folder.path().join("cameras.xml"), None).unwrap();
    assert!(views.frames.iter().all(|frame| frame.image.is_file()), "{:?}", views.frames);
}

#[test]
fn what_rays_are_not_known_of_is_refused_by_name() {
    let refused = |text: &str, words: &[&str]| {
        let error = read(text).unwrap_err().to_string();
        assert!(words.iter().all(|word| error.contains(word)), "{error}");
    };
    let whole = file(LENS, "");
    refused(
        &whole.replace("type=\"frame\" class=\"adj", "type=\"fisheye\" class=\"adj"),
        &["sensor 0", "`fisheye`", "undistorted"],
    );
    refused(&file("<f>50</f><b2>0.3</b2>", ""), &["sensor 0, of camera `IMG_1.JPG`", "b2 0.3"]);
    refused(&file("<f>50</f><p3>1</p3>", ""), &["p3 1"]);
    refused(&file("<fx>50</fx><fy>50</fy>", ""), &["focal length f", "fx 50, fy 50"]);
    refused(&file("<f>fifty</f>", ""), &["<f> fifty"]);
    refused(&file("<f>-5</f>", ""), &["above 0"]);
    refused(&whole.replace("sensor_id=\"0\" component", "sensor_id=\"7\" component"), &["`sensor_id`", "7"]);
    refused(&whole.replace("1 0 0 1 0 1 0 2", "1 0 0 1 0 1 0"), &["IMG_1.JPG", "<transform>", "16 finite numbers"]);
    refused(&whole.replace("1 0 0 1 0 1 0 2", "1 0 0 nan 0 1 0 2"), &["16 finite numbers"]);
    refused(&whole.replace("<transform>1 0 0 1 0 1", "<transform>1 0 0 1 0 -1"), &["`transform_matrix`"]);
    refused(&whole.replace(">2</scale>", ">big</scale>"), &["the chunk's transform, <scale>"]);
    refused(
        &whole.replace("<transform>", "<pose>").replace("</transform>", "</pose>"),
        &["aligned camera", "3 are not"],
    );
    refused("<svg></svg>", &["cameras.xml of Metashape", "another XML"]);
    refused("<document><chunk>", &["line 1", "XML"]);
    // Hostile: entities that multiply, and elements in elements.
    refused("<!DOCTYPE a [<!ENTITY b \"cc\">]><document>&b;</document>", &["XML"]);
    assert!(read(&"<chunk>".repeat(200_000)).is_err());
}
