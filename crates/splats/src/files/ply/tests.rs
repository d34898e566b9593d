use glam::Quat;

use super::*;

/// A file of these properties, whose numbers are the names' places in the list in eighths, a hundred more in each
/// row.
fn file(properties: &[&str], comments: &str) -> Vec<u8> {
    let lines: String = properties.iter().map(|property| format!("property {property}\n")).collect();
    let header = format!("ply\nformat binary_little_endian 1.0\n{comments}element vertex 2\n{lines}end_header\n");
    let mut bytes = header.into_bytes();
    for row in 0..2 {
        for (i, property) in properties.iter().enumerate() {
            let value = 100 * row + i;
            match property.split(' ').next().unwrap() {
                "float" => bytes.extend((value as f32 / 8.0).to_le_bytes()),
                "double" => bytes.extend((value as f64 / 8.0).to_le_bytes()),
                "uchar" => bytes.push(value as u8),
                other => panic!("{other}"),
            }
        }
    }
    bytes
}

fn properties(rest: usize) -> Vec<String> {
    let mut all: Vec<String> =
        ["float rot_3", "uchar label", "double x", "float z", "float y", "float opacity"].map(String::from).to_vec();
    all.extend((0..rest).map(|i| format!("float f_rest_{i}")));
    let others = ["scale_2", "scale_1", "f_dc_0", "f_dc_1", "f_dc_2", "scale_0", "rot_0", "rot_1", "rot_2", "time"];
    all.extend(others.map(|name| format!("float {name}")));
    all
}

fn read_file(properties: &[&str], comments: &str) -> Result<Splats> {
    read(Path::new("s.ply"), &file(properties, comments))
}

#[test]
fn properties_are_found_by_their_names() {
    for (degree, rest) in [(0, 0), (1, 9), (2, 24)] {
        let all = properties(rest);
        let names: Vec<&str> = all.iter().map(String::as_str).collect();
        let splats = read_file(&names, "comment made by hand\n").unwrap();
        let at = |name: &str| names.iter().position(|p| p.ends_with(&format!(" {name}"))).unwrap() as f32 / 8.0;
        assert_eq!((splats.degree(), splats.len(), splats.mode()), (degree, 2, RenderMode::Classic));
        assert_eq!(splats.mean(1), Vec3::new(at("x"), at("y"), at("z")) + 12.5);
        assert_eq!(splats.log_scales()[0], Vec3::new(at("scale_0"), at("scale_1"), at("scale_2")));
        assert_eq!(splats.opacity_logits(), [5.0, 105.0].map(|v| v / 8.0));
        let [w, x, y, z] = [0, 1, 2, 3].map(|i| at(&format!("rot_{i}")));
        let angle = splats.rotation(0).dot(Quat::from_xyzw(x, y, z, w).normalize());
        assert!((angle - 1.0).abs() < 1e-6, "{angle}");
        let k = coefficients(degree);
        for c in 0..3 {
            assert_eq!(splats.sh(1)[c], at(&format!("f_dc_{c}")) + 12.5);
            for higher in 1..k {
                let name = format!("f_rest_{}", c * (k - 1) + higher - 1);
                assert_eq!(splats.sh(1)[3 * higher + c], at(&name) + 12.5, "{name}");
            }
        }
        assert_eq!(splats.extra_names(), ["label", "time"]);
        assert_eq!(splats.extra("label"), Some(vec![1.0, 101.0]));
    }
}

#[test]
fn what_other_programs_write_beside_splats_is_passed_over() {
    let all = properties(0);
    let names: Vec<&str> = all.iter().map(String::as_str).collect();
    let plain = file(&names, "");
    let at = plain.windows(10).position(|window| window == b"end_header").unwrap();
    let body = at + 11;
    let with = |before: (&str, &[u8]), after: (&str, &[u8])| {
        let start = plain.windows(7).position(|window| window == b"element").unwrap();
        let parts: [&[u8]; 7] = [
            &plain[..start],
            before.0.as_bytes(),
            &plain[start..at],
            after.0.as_bytes(),
            b"end_header\n",
            before.1,
            &[&plain[body..], after.1].concat(),
        ];
        read(Path::new("s.ply"), &parts.concat())
    };
    let expected = read(Path::new("s.ply"), &plain).unwrap();
    let intrinsic = ("element intrinsic 2\nproperty float intrinsic\n", &[1; 8][..]);
    let list = ("element edge 2\nproperty list uchar short i\n", &[1, 7, 0, 0][..]);
    let faces = ("element face 0\nproperty list uchar int vertex_indices\n", &[][..]);
    for (before, after) in [(("", &[][..]), intrinsic), (list, faces), (intrinsic, list)] {
        assert_eq!(with(before, after).unwrap(), expected, "{before:?} {after:?}");
    }
    let space = |number: u8| with(intrinsic, ("element color_space 1\nproperty uchar color_space\n", &[number]));
    let sharp = space(0).unwrap();
    assert!(sharp.means() == expected.means() && sharp.notes().len() == expected.notes().len() + 1);
    let error = space(1).unwrap_err().to_string();
    assert!(error.contains("`color_space`: expected colours in sRGB, 0") && error.contains("found 1"), "{error}");
    let error = with(("element face 1\nproperty list uchar int i\n", &[0]), intrinsic).unwrap_err().to_string();
    assert!(error.contains("expected no faces (a mesh is no file of splats), found 1"), "{error}");
    let error = with(("element vertex 0\nproperty float x\n", &[]), intrinsic).unwrap_err().to_string();
    assert!(error.contains("header, elements: expected names once each, found `vertex` twice"), "{error}");
}

#[test]
fn colours_and_prefixes_of_other_programs_are_read() {
    let all = properties(9);
    let prefixed: Vec<String> = all
        .iter()
        .map(|property| {
            let (kind, name) = property.split_once(' ').unwrap();
            let prefix = ["", "scalar_", "scalar_scalar_"][usize::from(name.len() > 1) + usize::from(name == "time")];
            format!("{kind} {prefix}{name}")
        })
        .collect();
    let [plain, prefixed] =
        [&all, &prefixed].map(|all| read_file(&all.iter().map(String::as_str).collect::<Vec<_>>(), "").unwrap());
    assert_eq!(prefixed, plain);
    // Bytes 14, 15 and 16 in place of f_dc_0 to f_dc_2; a hundred more in the second row.
    let renamed = |kind: &str| -> Vec<String> {
        let color = |property: &String| match property.split_once("f_dc_") {
            Some((_, channel)) => format!("{kind} {}", COLORS[channel.parse::<usize>().unwrap()]),
            None => property.clone(),
        };
        properties(0).iter().map(color).collect()
    };
    let read_colors = |kind: &str| read_file(&renamed(kind).iter().map(String::as_str).collect::<Vec<_>>(), "");
    let splats = read_colors("uchar").unwrap();
    let first = renamed("uchar").iter().position(|name| name.ends_with("red")).unwrap();
    for (row, channel) in [(0, 0), (0, 2), (1, 1)] {
        let byte = (100 * row + first + channel) as f64;
        let found = 0.5 + 0.282_094_791_773_878_14 * f64::from(splats.sh(row)[channel]);
        assert!((found - byte / 255.0).abs() < 1e-7, "{found} {byte}");
    }
    let error = read_colors("float").unwrap_err().to_string();
    assert!(error.contains("splat 0, `green`: expected a colour up to 1") && error.contains("found 1.125"), "{error}");
}

#[test]
fn properties_that_change_pictures_are_applied_or_refused() {
    let all = properties(0);
    let with = |more: &str| {
        let names: Vec<&str> = all.iter().map(String::as_str).chain([more]).collect();
        read_file(&names, "")
    };
    let plain = with("float nx").unwrap();
    assert_eq!(plain.notes(), ["properties without a known meaning are kept, and do not change what is drawn: time"]);
    for (name, what) in [
        ("trbf_center", "`trbf_center`: splats that move in time"),
        ("f_offset_0", "`f_offset_0`: anchors of Scaffold-GS"),
        ("f_dc_3", "`f_dc_3`: colours that are no"),
    ] {
        let error = with(&format!("float {name}")).unwrap_err().to_string();
        assert!(error.contains(what) && error.contains("remove the property"), "{error}");
    }
    // Scaffold-GS has no colours of its own; that is not what it is refused for.
    let anchors: Vec<&str> = all.iter().map(String::as_str).filter(|name| !name.contains("f_dc")).collect();
    let error = read_file(&[&anchors[..], &["float f_anchor_feat_0"]].concat(), "").unwrap_err().to_string();
    assert!(error.contains("`f_anchor_feat_0`: anchors of Scaffold-GS"), "{error}");
    // The number of the last property is 16/8, and 116/8 in the second row.
    let filtered = with("float filter_3D").unwrap();
    assert_eq!((filtered.mode(), filtered.extra_names()), (RenderMode::MipSplatting, vec!["label", "time"]));
    let f = [0, 1].map(|row| (100 * row + all.len()) as f64 / 8.0);
    for (i, f) in f.into_iter().enumerate() {
        let squared = |splats: &Splats| splats.log_scales()[i].as_dvec3().to_array().map(|s| (2.0 * s).exp());
        let (before, after) = (squared(&plain), squared(&filtered));
        for axis in 0..3 {
            assert!((after[axis] / (before[axis] + f * f) - 1.0).abs() < 1e-5, "{before:?} {after:?}");
        }
        let ratio = (before.iter().product::<f64>() / after.iter().product::<f64>()).sqrt();
        let expected = f64::from(plain.opacity(i)) * ratio;
        assert!((f64::from(filtered.opacity(i)) / expected - 1.0).abs() < 1e-5, "splat {i}");
    }
    // It is written as it is drawn, and so is not applied again.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.ply");
    filtered.write_ply(&path, &[], &[]).unwrap();
    let again = Splats::read(&path).unwrap();
    assert_eq!((again.log_scales(), again.mode()), (filtered.log_scales(), filtered.mode()));
    assert_eq!(again.opacity_logits(), filtered.opacity_logits());
}

#[test]
fn the_render_mode_is_read_from_the_header() {
    let all = properties(0);
    let names: Vec<&str> = all.iter().map(String::as_str).collect();
    let mode = |comment: &str| read_file(&names, comment).map(|splats| splats.mode());
    assert_eq!(mode("comment SplatRenderMode: mip\n").unwrap(), RenderMode::Mip);
    assert_eq!(mode("comment SplatRenderMode: default\n").unwrap(), RenderMode::Classic);
    assert_eq!(mode("comment antialiased 1\n").unwrap(), RenderMode::Mip);
    assert_eq!(mode("comment antialiased 1\ncomment SplatRenderMode: default\n").unwrap(), RenderMode::Classic);
    let both = "comment SplatRenderMode: mip\ncomment SplatDilation: 0.1\n";
    assert_eq!(mode(both).unwrap(), RenderMode::MipSplatting);
    assert!(mode("comment SplatDilation: 0.1\n").unwrap_err().to_string().contains("`0.1` after mode `mip`"));
    let error = mode("comment SplatRenderMode: soft\n").unwrap_err().to_string();
    assert!(error.contains("comment `SplatRenderMode:`: expected `mip` or `default`, found `soft`"), "{error}");
}

#[test]
fn files_of_something_else_are_refused_by_what_they_lack() {
    let all = properties(9);
    let without = |name: &str| -> Vec<&str> {
        all.iter().map(String::as_str).filter(|p| !p.ends_with(&format!(" {name}"))).collect()
    };
    for (name, expected) in [
        ("scale_2", "a property `scale_2` (2D splats have no third scale"),
        ("f_dc_1", "a property `f_dc_1`, found rot_3 label x z y opacity"),
        ("opacity", "a property `opacity`, found rot_3 label x z y"),
        ("f_rest_8", "0, 9, 24 or 45 properties `f_rest_…`, spherical harmonics of degree 0 to 3, found 8"),
    ] {
        let error = read_file(&without(name), "").unwrap_err().to_string();
        assert!(error.starts_with("s.ply: header: expected") && error.contains(expected), "{error}");
    }
    let text = b"ply\nformat binary_little_endian 1.0\nelement face 0\nend_header\n";
    let error = read(Path::new("s.ply"), text).unwrap_err().to_string();
    assert!(error.contains("an element `vertex`, found elements `face`"), "{error}");
}
