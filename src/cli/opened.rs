//! A field as verbs take it: a file, or a folder of tiles.

use std::path::Path;

use crate::open::refuse_model;
use crate::session::memory::available;
use crate::uncertainty::{Answers, BakedField, TiledField, UncertaintyField};
use crate::{Error, Result};

/// Bytes for tiles if the system does not report free memory.
const DEFAULT_ROOM: u64 = 4 << 30;

/// A field whose answers may still be in files.
pub enum OpenedField {
    /// In memory.
    Whole(Box<UncertaintyField>),
    /// In a folder.
    Tiles(Box<TiledField>),
}

impl OpenedField {
    /// Reads a field, or opens a folder of tiles, which may take half of the memory that is free. Refuses a tile, which
    /// covers only a part of space.
    pub fn open(path: &Path) -> Result<Self> {
        refuse_model(path)?;
        if path.is_dir() {
            let room = available().unwrap_or(DEFAULT_ROOM) / 2;
            return Ok(Self::Tiles(Box::new(TiledField::open(path, room as usize)?)));
        }
        if path.extension().is_some_and(|extension| extension == "npy") {
            let name = path.display();
            let expected =
                format!("`.oct`; of a grid of the official code, `export {name} -o FIELD.oct --box=BOX` makes one");
            return Err(Error::malformed(path, "file name", expected, "`.npy`"));
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

    /// What does not depend on the place, such as the record and the box: the field, or one of its tiles.
    pub fn facts(&self) -> &UncertaintyField {
        self.space().facts()
    }

    /// What does.
    pub fn space(&self) -> &dyn Answers {
        match self {
            Self::Whole(field) => &**field,
            Self::Tiles(tiles) => &**tiles,
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
            Self::Tiles(tiles) => tiles.joined(),
        }
    }
}
