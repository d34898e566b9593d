//! The octree as a VTK hyper tree grid (`.htg`), which ParaView opens as it is.
//!
//! The XML format, version 2.0: one tree, whose cells are listed level by level. Cells of a level stand in the order of
//! their parents, and children in the order x, y, z with x fastest, which is Morton order. Arrays follow the XML as raw
//! bytes, each behind its length as a 64-bit integer; their places are known beforehand.

use std::io::Write;
use std::path::Path;

use super::cells::{Splits, at_centers, knows};
use super::leaves::code;
use octobayes::geometry::{Domain, Lattice};
use octobayes::io::AtomicFile;
use octobayes::octree::Cell;
use octobayes::uncertainty::UncertaintyField;
use octobayes::{Error, Result};

/// An array behind the XML.
struct Array {
    /// Name of VTK's type.
    kind: &'static str,
    name: &'static str,
    /// Number of entries.
    count: u64,
    /// Bytes without the length before them.
    bytes: u64,
    /// Place behind the XML.
    offset: u64,
}

/// Writes all cells, split ones too, with log10 U at their centres, their level, and if the field stores them the rays
/// there and whether they were seen (0 never seen, 1 free, 2 constrained).
///
/// A contracted domain is written as its cube: the part that is not contracted in scene units, the rest folded around
/// it.
///
/// # Errors
/// If the file cannot be written.
pub fn write_hyper_tree(path: &Path, field: &UncertaintyField) -> Result<()> {
    let splits = Splits::of(field);
    let per_level = splits.cells_per_level();
    let levels = per_level.len() as u64;
    let cells: u64 = per_level.iter().sum();
    // Cells of the last level are leaves, and need no bit.
    let described = cells - per_level.last().copied().unwrap_or(0);
    let sides = sides(field.lattice());

    let mut arrays = Vec::new();
    let mut offset = 0;
    let mut array = |kind, name, count: u64, bits: u64| {
        let bytes = (count * bits).div_ceil(8);
        arrays.push(Array { kind, name, count, bytes, offset });
        offset += 8 + bytes;
    };
    for name in ["XCoordinates", "YCoordinates", "ZCoordinates"] {
        array("Float64", name, 2, 64);
    }
    array("Bit", "Descriptors", described, 1);
    array("Int64", "NumberOfVerticesPerDepth", levels, 64);
    array("Int64", "TreeIds", 1, 64);
    array("UInt32", "DepthPerTree", 1, 32);
    array("Float32", "log10_uncertainty", cells, 32);
    array("UInt8", "level", cells, 8);
    let [knows_rays, knows_coverage] = knows(field);
    if knows_rays {
        array("Float32", "rays", cells, 32);
    }
    if knows_coverage {
        array("UInt8", "seen", cells, 8);
    }

    let mut file = AtomicFile::create(path)?;
    let all = || (0..per_level.len() as u8).flat_map(|level| splits.cells(level));
    let failed = |e| Error::io(path, "cannot write")(e);
    write_head(&mut file, &arrays).map_err(failed)?;
    for array in &arrays {
        let mut put = |bytes: &[u8]| file.write_all(bytes).map_err(failed);
        put(&array.bytes.to_le_bytes())?;
        let mut answers = at_centers(field, all().map(|(cell, _)| cell));
        match array.name {
            "Descriptors" => {
                write_bits(&mut file, all().take(described as usize).map(|(_, is_split)| is_split)).map_err(failed)?;
            }
            "NumberOfVerticesPerDepth" => per_level.iter().try_for_each(|n| put(&n.to_le_bytes()))?,
            "TreeIds" => put(&0_u64.to_le_bytes())?,
            "DepthPerTree" => put(&(levels as u32).to_le_bytes())?,
            "log10_uncertainty" => {
                answers.try_for_each(|found| put(&(found.estimate.uncertainty.log10() as f32).to_le_bytes()))?;
            }
            "level" => all().try_for_each(|(Cell { level, .. }, _)| put(&[level]))?,
            "rays" => {
                answers.try_for_each(|found| put(&(found.estimate.rays.unwrap_or(0.0) as f32).to_le_bytes()))?;
            }
            "seen" => answers.try_for_each(|found| put(&[code(found.observability)]))?,
            side => {
                let axis = ["XCoordinates", "YCoordinates", "ZCoordinates"].iter().position(|name| *name == side);
                sides[axis.expect("one of the arrays above")].iter().try_for_each(|v| put(&v.to_le_bytes()))?;
            }
        }
    }
    file.write_all(b"\n  </AppendedData>\n</VTKFile>\n").map_err(failed)?;
    file.commit()
}

/// Both ends of the root cell along x, y and z.
fn sides(lattice: &Lattice) -> [[f64; 2]; 3] {
    let (low, high) = match lattice.domain() {
        Domain::Box(bounds) => (bounds.min(), bounds.max()),
        Domain::Contracted { center, radius, .. } => {
            let center = glam::DVec3::from(*center);
            (center - 2.0 * *radius, center + 2.0 * *radius)
        }
    };
    std::array::from_fn(|axis| [low[axis], high[axis]])
}

/// The XML up to the first array's bytes.
fn write_head(out: &mut impl Write, arrays: &[Array]) -> std::io::Result<()> {
    writeln!(out, "<?xml version=\"1.0\"?>")?;
    writeln!(
        out,
        "<VTKFile type=\"HyperTreeGrid\" version=\"2.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">"
    )?;
    writeln!(out, "  <HyperTreeGrid BranchFactor=\"2\" TransposedRootIndexing=\"0\" Dimensions=\"2 2 2\">")?;
    let (grid, rest) = arrays.split_at(3);
    let (trees, data) = rest.split_at(4);
    for (section, arrays) in [("Grid", grid), ("Trees", trees), ("CellData", data)] {
        writeln!(out, "    <{section}>")?;
        for Array { kind, name, count, offset, .. } in arrays {
            writeln!(
                out,
                "      <DataArray type=\"{kind}\" Name=\"{name}\" NumberOfTuples=\"{count}\" format=\"appended\" \
                 offset=\"{offset}\"/>"
            )?;
        }
        writeln!(out, "    </{section}>")?;
    }
    write!(out, "  </HyperTreeGrid>\n  <AppendedData encoding=\"raw\">\n   _")
}

/// Writes bits, eight to a byte, the first in the highest place.
fn write_bits(out: &mut impl Write, bits: impl Iterator<Item = bool>) -> std::io::Result<()> {
    let (mut byte, mut filled) = (0_u8, 0);
    for bit in bits {
        byte = byte << 1 | u8::from(bit);
        filled += 1;
        if filled == 8 {
            out.write_all(&[byte])?;
            (byte, filled) = (0, 0);
        }
    }
    if filled > 0 { out.write_all(&[byte << (8 - filled)]) } else { Ok(()) }
}
