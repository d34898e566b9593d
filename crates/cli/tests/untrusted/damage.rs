//! Damage to valid files: as a whole, or to the contents that a file with right lengths and checksums is made from.

use super::{Kind, forge};

/// What happens to some bytes. Places are fractions of its length.
#[derive(Debug, Clone)]
pub enum Damage {
    Set(f64, u8),
    Flip(f64, u8),
    Cut(f64),
    /// A run of digits, or of bytes, becomes a large number.
    Grow(f64, usize),
    Remove(f64, usize),
    /// Some bytes are repeated elsewhere.
    Copy(f64, f64, usize),
    Insert(f64, Vec<u8>),
}

impl Damage {
    pub fn apply(&self, bytes: &mut Vec<u8>) {
        let n = bytes.len();
        let place = |share: f64| (share * n as f64) as usize;
        if n == 0 {
            return;
        }
        match self {
            Self::Set(at, byte) => bytes[place(*at)] = *byte,
            Self::Flip(at, bit) => bytes[place(*at)] ^= 1 << bit,
            Self::Cut(at) => bytes.truncate(place(*at)),
            Self::Grow(at, width) => {
                let at = place(*at);
                match bytes[at..].iter().position(u8::is_ascii_digit).filter(|_| width % 2 == 0) {
                    Some(digit) => drop(bytes.splice(at + digit..=at + digit, *b"1000000000000")),
                    None => bytes[at..(at + width).min(n)].fill(0xff),
                }
            }
            Self::Remove(at, count) => {
                let at = place(*at);
                bytes.drain(at..(at + count).min(n));
            }
            Self::Copy(from, to, count) => {
                let from = place(*from);
                let copy = bytes[from..(from + count).min(n)].to_vec();
                let to = place(*to);
                bytes.splice(to..to, copy);
            }
            Self::Insert(at, new) => {
                let at = place(*at);
                bytes.splice(at..at, new.iter().copied());
            }
        }
    }
}

/// `whole`, damaged as it is, or `by_parts` and put together anew. The fractions choose the parts.
pub fn file(kind: Kind, whole: &[u8], by_parts: bool, damages: &[(f64, Damage)]) -> Vec<u8> {
    if !by_parts {
        let mut bytes = whole.to_vec();
        damages.iter().for_each(|(_, damage)| damage.apply(&mut bytes));
        return bytes;
    }
    let recipe = forge::recipe(kind, whole);
    // Kinds without parts are a single part.
    let is_split = recipe[0] % 2 == 1;
    let mut parts: Vec<Vec<u8>> = match is_split {
        true => forge::split(&recipe[1..]).into_iter().map(<[u8]>::to_vec).collect(),
        false => vec![recipe[1..].to_vec()],
    };
    let count = parts.len() as f64;
    damages.iter().for_each(|(part, damage)| damage.apply(&mut parts[(part * count) as usize]));
    if is_split { forge::file(kind, &forge::join(&parts)) } else { parts.remove(0) }
}
