//! Columns of a PLY file: the parameters that renderers read, and everything else that a tool left there.

use octobayes::{Error, Result};

/// A scalar type of PLY.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    /// The type of a name, of the older or the newer set of names.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// The older name, which all programs read.
    pub const fn name(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Size, bytes.
    pub const fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in `bytes`, little-endian and of this type's size.
    pub fn decode(self, bytes: &[u8]) -> f64 {
        match self {
            Self::I8 => f64::from(i8::from_le_bytes([bytes[0]])),
            Self::U8 => f64::from(bytes[0]),
            Self::I16 => f64::from(i16::from_le_bytes([bytes[0], bytes[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            Self::I32 => f64::from(i32::from_le_bytes(word(bytes))),
            Self::U32 => f64::from(u32::from_le_bytes(word(bytes))),
            Self::F32 => f64::from(f32::from_le_bytes(word(bytes))),
            Self::F64 => {
                f64::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3], bytes[4], bytes[5], bytes[6], bytes[7]])
            }
        }
    }
}

fn word(bytes: &[u8]) -> [u8; 4] {
    [bytes[0], bytes[1], bytes[2], bytes[3]]
}

/// What a property beside the parameters does to the pictures of a program that writes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Effect {
    /// Nothing.
    None,
    /// It is the radius of Mip-Splatting's filter, which belongs to scales and opacities.
    Filter,
    /// It changes them in a way that is not drawn here; the text names it.
    Changes(&'static str),
}

const MOVING: &str = "splats that move in time";
const ANCHORS: &str = "anchors of Scaffold-GS, from which a network makes the splats of each view";
const SHADED: &str = "splats whose colours come from materials and light";
const OTHER_COLORS: &str = "colours that are no spherical harmonics";
const OTHER_SHAPES: &str = "splats of another shape than a Gaussian's";

/// Properties that known programs write. `*` stands for the rest of a name.
const KNOWN: [(Effect, &[&str]); 8] = [
    (Effect::Filter, &["filter_3D", "filter_3d"]),
    (Effect::Changes(ANCHORS), &["f_offset*", "f_anchor*"]),
    (Effect::Changes(MOVING), &["trbf_*", "motion_*", "omega_*", "f_t_*", "t", "scale_t", "scaling_t", "rot_r_*"]),
    (
        Effect::Changes(SHADED),
        &[
            "base_color*",
            "albedo*",
            "roughness*",
            "metallic*",
            "specular*",
            "diffuse*",
            "fresnel*",
            "refl*",
            "incidents_*",
        ],
    ),
    (Effect::Changes(OTHER_COLORS), &["sg_*", "rgb_base_*", "sb_*", "asg_*", "f_dc_*"]),
    (Effect::Changes(OTHER_SHAPES), &["beta", "shape", "nu_degree", "scale_*", "rot_*"]),
    // Normals, colours beside the harmonics, labels, and columns of this crate and of editors.
    (
        Effect::None,
        &[
            "n?",
            "red",
            "green",
            "blue",
            "alpha",
            "uncertainty",
            "log10_uncertainty",
            "seen",
            "weight",
            "views",
            "front_share",
            "octobayes_*",
        ],
    ),
    (
        Effect::None,
        &["*label*", "*semantic*", "*feature*", "ins_feat*", "sem_*", "obj_dc_*", "*id", "*index", "segment*", "state"],
    ),
];

impl Effect {
    /// What a property does, if a known program writes it.
    pub fn of(name: &str) -> Option<Self> {
        KNOWN.iter().find(|(_, names)| names.iter().any(|pattern| fits(pattern, name))).map(|(effect, _)| *effect)
    }

    /// The first property of these that changes pictures in a way that is not drawn here, in the order of the table,
    /// and what it changes.
    pub fn first_change<'a>(names: &[&'a str]) -> Option<(&'a str, &'static str)> {
        KNOWN.iter().find_map(|(effect, patterns)| {
            let Self::Changes(what) = effect else { return None };
            let name = names.iter().find(|name| patterns.iter().any(|pattern| fits(pattern, name)))?;
            Some((*name, *what))
        })
    }
}

/// Whether a name is of a pattern, in which `*` is any text and `?` any letter.
fn fits(pattern: &str, name: &str) -> bool {
    match (pattern.split_at_checked(1), name.chars().next()) {
        (None, first) => first.is_none(),
        (Some(("*", rest)), _) => name.char_indices().any(|(i, _)| fits(rest, &name[i..])) || fits(rest, ""),
        (Some((one, rest)), Some(first)) if one == "?" || one.starts_with(first) => {
            fits(rest, &name[first.len_utf8()..])
        }
        _ => false,
    }
}

/// A property that this crate gives no meaning to. It is written back as it was read.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Extra {
    pub name: String,
    pub kind: Scalar,
    /// The numbers of all splats, little-endian.
    pub bytes: Vec<u8>,
}

impl Extra {
    /// A `float` property.
    pub fn floats(name: &str, values: &[f32]) -> Self {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        Self { name: name.to_string(), kind: Scalar::F32, bytes }
    }

    /// The number of splat `i`.
    pub fn number(&self, i: usize) -> f64 {
        self.kind.decode(self.of(i))
    }

    /// The bytes of splat `i`.
    pub fn of(&self, i: usize) -> &[u8] {
        let size = self.kind.size();
        &self.bytes[i * size..(i + 1) * size]
    }

    /// The numbers of the splats that are kept.
    pub fn keep(&mut self, kept: &[bool]) {
        let size = self.kind.size();
        let numbers = self.bytes.chunks_exact(size).zip(kept).filter(|(_, keep)| **keep);
        self.bytes = numbers.flat_map(|(number, _)| number).copied().collect();
    }
}

/// What a property means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Field {
    /// `x`, `y`, `z`.
    Mean(usize),
    /// `scale_0` to `scale_2`.
    Scale(usize),
    /// `rot_0` to `rot_3`: w, x, y, z.
    Rotation(usize),
    /// `opacity`.
    Opacity,
    /// `f_dc_0` to `f_dc_2`: red, green and blue of the constant coefficient.
    Constant(usize),
    /// `f_rest_0` and so on: all higher coefficients of red, then green, then blue.
    Rest(usize),
    /// Index of an [`Extra`].
    Extra(usize),
}

impl Field {
    /// The meaning of a name, if it has one.
    pub fn named(name: &str) -> Option<Self> {
        let numbered = |prefix: &str, count: usize| {
            let digits = name.strip_prefix(prefix)?;
            digits.parse().ok().filter(|n: &usize| *n < count && n.to_string() == digits)
        };
        match name {
            "x" => Some(Self::Mean(0)),
            "y" => Some(Self::Mean(1)),
            "z" => Some(Self::Mean(2)),
            "opacity" => Some(Self::Opacity),
            _ => numbered("scale_", 3)
                .map(Self::Scale)
                .or_else(|| numbered("rot_", 4).map(Self::Rotation))
                .or_else(|| numbered("f_dc_", 3).map(Self::Constant))
                .or_else(|| numbered("f_rest_", usize::MAX).map(Self::Rest)),
        }
    }

    /// The name of a property with this meaning.
    pub fn name(self, extras: &[Extra]) -> String {
        match self {
            Self::Mean(axis) => ["x", "y", "z"][axis].into(),
            Self::Scale(axis) => format!("scale_{axis}"),
            Self::Rotation(entry) => format!("rot_{entry}"),
            Self::Opacity => "opacity".into(),
            Self::Constant(channel) => format!("f_dc_{channel}"),
            Self::Rest(entry) => format!("f_rest_{entry}"),
            Self::Extra(index) => extras[index].name.clone(),
        }
    }

    /// All but extra properties, in the order of the original code.
    pub fn all(degree: u8) -> Vec<Self> {
        let rest = 3 * (super::coefficients(degree) - 1);
        let axes = || 0..3;
        let mut fields: Vec<Self> = axes().map(Self::Mean).collect();
        fields.extend(axes().map(Self::Constant));
        fields.extend((0..rest).map(Self::Rest));
        fields.push(Self::Opacity);
        fields.extend(axes().map(Self::Scale));
        fields.extend((0..4).map(Self::Rotation));
        fields
    }
}

/// The properties of a file in their order, with those that have no meaning here, and the header's comments.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    pub order: Vec<Field>,
    pub extras: Vec<Extra>,
    pub comments: Vec<String>,
    pub packing: Packing,
}

/// How a file packed its numbers. It is packed in the same way when it is written in its own format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Packing {
    /// It did not.
    None,
    /// Splats that follow each other share ranges, and lie near each other: `.compressed.ply`.
    Chunks,
    /// `.spz`.
    Spz { version: u32, fractional_bits: u8 },
}

impl Layout {
    /// The layout of the original code, with its normals: zeros, which its viewer expects to be there.
    pub fn original(degree: u8, count: usize) -> Self {
        let mut order = Field::all(degree);
        order.splice(3..3, (0..3).map(Field::Extra));
        let zeros = vec![0.0; count];
        let extras = ["nx", "ny", "nz"].map(|name| Extra::floats(name, &zeros)).to_vec();
        Self { order, extras, comments: Vec::new(), packing: Packing::None }
    }

    /// Takes out a property with this effect.
    pub fn take(&mut self, effect: Effect) -> Option<Extra> {
        let index = self.extras.iter().position(|extra| Effect::of(&extra.name) == Some(effect))?;
        self.order.retain(|field| *field != Field::Extra(index));
        for field in &mut self.order {
            if let Field::Extra(later) = field {
                *later -= usize::from(*later > index);
            }
        }
        Some(self.extras.remove(index))
    }

    /// Appends a property; one of the same name, which an earlier run left, goes.
    ///
    /// # Errors
    /// If the name is that of a parameter or no word, if there are not as many values as splats, or if a value is not
    /// finite.
    pub fn append(&mut self, name: &str, values: &[f32], count: usize) -> Result<()> {
        let what = || format!("column `{name}`");
        let is_word = !name.is_empty() && name.chars().all(|c| c.is_ascii_graphic());
        if !is_word || Field::named(name).is_some() {
            let expected = "a word that names no parameter of splats";
            return Err(Error::setting("column", expected, format!("`{name}`")));
        }
        if values.len() != count {
            return Err(Error::setting(what(), format!("{count} values, one per splat"), values.len().to_string()));
        }
        if let Some(i) = values.iter().position(|value| !value.is_finite()) {
            let found = format!("{} of splat {i}", values[i]);
            return Err(Error::setting(what(), "finite values", found));
        }
        let extra = Extra::floats(name, values);
        if let Some(old) = self.extras.iter().position(|extra| extra.name == name) {
            self.order.retain(|field| *field != Field::Extra(old));
            self.extras[old] = extra;
            self.order.push(Field::Extra(old));
        } else {
            self.extras.push(extra);
            self.order.push(Field::Extra(self.extras.len() - 1));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_the_meaning_that_they_are_written_for() {
        for degree in 0..=3 {
            for field in Field::all(degree) {
                assert_eq!(Field::named(&field.name(&[])), Some(field));
            }
        }
        assert_eq!(Field::all(3).len(), 59);
        for name in ["rot_4", "scale_3", "f_dc_3", "nx", "f_rest_", "f_rest_01", "f_rest_+1", "rot_-0", "X", ""] {
            assert_eq!(Field::named(name), None, "{name}");
        }
    }

    #[test]
    fn properties_of_other_programs_are_harmless_applied_or_refused() {
        for (name, expected) in [
            ("nx", Some(Effect::None)),
            ("seen", Some(Effect::None)),
            ("language_feature_12", Some(Effect::None)),
            ("object_id", Some(Effect::None)),
            ("filter_3D", Some(Effect::Filter)),
            ("trbf_center", Some(Effect::Changes(MOVING))),
            ("omega_3", Some(Effect::Changes(MOVING))),
            ("f_offset_29", Some(Effect::Changes(ANCHORS))),
            ("f_dc_3", Some(Effect::Changes(OTHER_COLORS))),
            ("scale_5", Some(Effect::Changes(OTHER_SHAPES))),
            ("roughness", Some(Effect::Changes(SHADED))),
            ("time", None),
            ("confidence", None),
            ("", None),
            ("nxy", None),
            ("ü", None),
        ] {
            assert_eq!(Effect::of(name), expected, "{name}");
        }
        // Scaffold-GS has six scales as well, but its offsets are what it is known by.
        assert_eq!(Effect::first_change(&["nx", "scale_3", "f_offset_0"]), Some(("f_offset_0", ANCHORS)));
        assert_eq!(Effect::first_change(&["nx", "time"]), None);
    }

    #[test]
    fn every_type_of_number_is_decoded() {
        let all = ["char", "uchar", "short", "ushort", "int", "uint", "float", "double"];
        for name in all {
            let kind = Scalar::named(name).unwrap();
            assert_eq!(kind.name(), name);
            // The largest byte first shows the sign, zeros elsewhere the order.
            let mut bytes = [0_u8; 8];
            bytes[kind.size() - 1] = 0xc0;
            let value = kind.decode(&bytes[..kind.size()]);
            let bits = 8 * kind.size() as i32 - 8;
            let expected = match kind {
                Scalar::F32 | Scalar::F64 => -2.0,
                Scalar::I8 | Scalar::I16 | Scalar::I32 => -64.0 * 2_f64.powi(bits),
                Scalar::U8 | Scalar::U16 | Scalar::U32 => 192.0 * 2_f64.powi(bits),
            };
            assert_eq!(value, expected, "{name}");
        }
        assert_eq!(Scalar::named("half"), None);
    }
}
