//! A field as verbs take it: a file, or a folder of tiles.

use std::path::Path;
use std::sync::Arc;

use crate::io::memory::available;
use crate::uncertainty::{Answers, BakedField, TiledField, UncertaintyField};
use crate::{Error, Result};

/// Bytes for tiles where the system does not say what is free.
const DEFAULT_ROOM: u64 = 4 << 30;

/// A field whose answers may still be in files.
pub enum OpenedField {
    /// In memory.
    Whole(Box<UncertaintyField>),
    /// In a folder, and one of its tiles.
    Tiles(Box<TiledField>, Arc<UncertaintyField>),
}

impl OpenedField {
    /// Reads a field, or opens a folder of tiles, which may take half of the memory that is free. Refuses a tile, which
    /// knows only a part of space.
    pub fn open(path: &Path) -> Result<Self> {
        if path.is_dir() {
            let room = available().unwrap_or(DEFAULT_ROOM) / 2;
            let tiles = TiledField::open(path, room as usize)?;
            let any = tiles.tile(0)?;
            return Ok(Self::Tiles(Box::new(tiles), any));
        }
        let field = UncertaintyField::read(path)?;
        match field.tile() {
            Some(tile) => {
                let what = format!("part of space of {}", path.display());
                Err(Error::setting(what, "all of it", format!("tile {tile} (`merge` joins all tiles of a run)")))
            }
            None => Ok(Self::Whole(Box::new(field))),
        }
    }

    /// What does not depend on the place, such as the protocol and the box: the field, or one of its tiles.
    pub fn facts(&self) -> &UncertaintyField {
        match self {
            Self::Whole(field) => field,
            Self::Tiles(_, any) => any,
        }
    }

    /// What does.
    pub fn space(&self) -> &dyn Answers {
        match self {
            Self::Whole(field) => &**field,
            Self::Tiles(tiles, _) => &**tiles,
        }
    }

    /// The field with the values of its leaves side by side, if it is in memory, a quarter of what is free has room
    /// for them, and so many questions are to come that gathering them pays.
    pub fn baked(&self, questions: u64) -> Option<BakedField<'_>> {
        let Self::Whole(field) = self else { return None };
        let pays = questions >= field.deviations().len() as u64;
        let room = available().unwrap_or(DEFAULT_ROOM) / 4;
        pays.then(|| BakedField::within(room as usize, field))
    }

    /// The field in memory.
    pub fn whole(self) -> Result<UncertaintyField> {
        match self {
            Self::Whole(field) => Ok(*field),
            Self::Tiles(tiles, _) => tiles.joined(),
        }
    }
}
