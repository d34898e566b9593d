//! Elements of NumPy arrays: numbers of any type, which are stored as one type and read as another.

use std::io::{self, Read};

use half::f16;

/// A type of numbers that arrays are written in.
pub trait Stored: Copy {
    /// NumPy's name of the type.
    const DTYPE: &'static str;

    /// Appends the number's bytes.
    fn put(self, out: &mut Vec<u8>);
}

macro_rules! stored {
    ($($type:ty, $dtype:literal;)*) => {
        $(impl Stored for $type {
            const DTYPE: &'static str = $dtype;

            fn put(self, out: &mut Vec<u8>) {
                out.extend(self.to_le_bytes());
            }
        })*
    };
}

stored! {
    f16, "<f2"; f32, "<f4"; f64, "<f8";
    i8, "|i1"; i16, "<i2"; i32, "<i4"; i64, "<i8";
    u8, "|u1"; u16, "<u2"; u32, "<u4"; u64, "<u8";
}

/// What an array is read as.
pub trait Element: Sized {
    /// The accepted types, in words.
    const ACCEPTED: &'static str;
    /// Whether floats are among them.
    const FLOATS: bool;

    /// The element that is stored as this number; `None` below the smallest.
    fn of(number: Number) -> Option<Self>;
}

/// A real number, rounded to f32: of type f16, f32, f64, or an integer of any size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Real(pub f32);

impl Element for Real {
    const ACCEPTED: &'static str = "f16, f32, f64 or an integer type";
    const FLOATS: bool = true;

    fn of(number: Number) -> Option<Self> {
        Some(match number {
            Number::Float(value) => Self(value as f32),
            Number::Whole(value) => Self(value as f32),
        })
    }
}

/// A number from 0, such as an index or a count: an integer of any size, with or without sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Index(pub u64);

impl Element for Index {
    const ACCEPTED: &'static str = "an integer type (`.astype(\"u4\")`)";
    const FLOATS: bool = false;

    fn of(number: Number) -> Option<Self> {
        match number {
            Number::Whole(value) => u64::try_from(value).ok().map(Self),
            Number::Float(_) => None,
        }
    }
}

/// A number as it is stored. Both kinds hold all values of their types exactly.
pub enum Number {
    Float(f64),
    Whole(i128),
}

/// The type in which an array's numbers are stored.
pub struct Dtype {
    kind: u8,
    /// Bytes of a number.
    pub size: usize,
    has_high_byte_first: bool,
}

impl Dtype {
    /// Reads NumPy's name of a type, such as `<f4`, if it is one of numbers.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        let &[order @ (b'<' | b'>' | b'|'), kind, size] = name.as_bytes() else { return None };
        let is_known = matches!((kind, size), (b'i' | b'u', b'1' | b'2' | b'4' | b'8') | (b'f', b'2' | b'4' | b'8'));
        is_known.then_some(Self { kind, size: usize::from(size - b'0'), has_high_byte_first: order == b'>' })
    }

    #[must_use]
    /// Whether these are floats.
    pub fn is_float(&self) -> bool {
        self.kind == b'f'
    }

    /// Reads the next number.
    pub fn read(&self, bytes: &mut impl Read) -> io::Result<Number> {
        let mut all = [0; 8];
        let stored = &mut all[..self.size];
        bytes.read_exact(stored)?;
        if self.has_high_byte_first {
            stored.reverse();
        }
        let bits = u64::from_le_bytes(all);
        Ok(match (self.kind, self.size) {
            (b'f', 2) => Number::Float(f16::from_bits(bits as u16).into()),
            (b'f', 4) => Number::Float(f32::from_bits(bits as u32).into()),
            (b'f', _) => Number::Float(f64::from_bits(bits)),
            (b'u', _) => Number::Whole(bits.into()),
            // The sign is the highest of the stored bits.
            (_, size) => Number::Whole((bits.cast_signed() << (64 - 8 * size) >> (64 - 8 * size)).into()),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::npy;
    use crate::npy::ArrayStream;

    fn parse<T: Element>(bytes: &[u8]) -> octobayes::Result<Vec<T>> {
        Ok(ArrayStream::<T, _>::new(bytes, bytes.len() as u64, Path::new("x.npy"), "data")?.into_array()?.data)
    }

    fn bytes<T: Stored>(values: [T; 2]) -> Vec<u8> {
        let mut bytes = Vec::new();
        npy::write_to(&mut bytes, Path::new("memory"), &[2], values).unwrap();
        bytes
    }

    /// The array with another type of the same size.
    fn renamed(mut array: Vec<u8>, from: &str, to: &str) -> Vec<u8> {
        let at = array.windows(3).position(|name| name == from.as_bytes()).unwrap();
        array[at..at + 3].copy_from_slice(to.as_bytes());
        array
    }

    #[test]
    fn numbers_of_all_types_are_converted() {
        let arrays = [
            bytes([f16::from_f32(1.0), f16::from_f32(100.0)]),
            bytes([1.0_f32, 100.0]),
            bytes([1.0_f64, 100.0]),
            bytes([1_i8, 100]),
            bytes([1_i16, 100]),
            bytes([1_i32, 100]),
            bytes([1_i64, 100]),
            bytes([1_u8, 100]),
            bytes([1_u16, 100]),
            bytes([1_u32, 100]),
            bytes([1_u64, 100]),
        ];
        for (i, array) in arrays.iter().enumerate() {
            assert_eq!(parse::<Real>(array).unwrap(), [Real(1.0), Real(100.0)], "array {i}");
            let index = parse::<Index>(array);
            match i {
                0..3 => assert!(index.unwrap_err().to_string().contains("integer"), "array {i}"),
                _ => assert_eq!(index.unwrap(), [Index(1), Index(100)], "array {i}"),
            }
        }
        // The other order of bytes, as NumPy writes it for `>f8`.
        let mut big = renamed(bytes([1.0_f64, 100.0]), "<f8", ">f8");
        let end = big.len();
        big[end - 16..end - 8].reverse();
        big[end - 8..].reverse();
        assert_eq!(parse::<Real>(&big).unwrap(), [Real(1.0), Real(100.0)]);
        for low in [bytes([-128_i8, -1]), bytes([-128_i16, -1]), bytes([-128_i32, -1]), bytes([-128_i64, -1])] {
            assert_eq!(parse::<Real>(&low).unwrap(), [Real(-128.0), Real(-1.0)]);
        }
    }

    #[test]
    fn what_is_no_such_number_is_refused() {
        let flags = renamed(bytes([0_u8, 1]), "|u1", "|b1");
        let error = parse::<Real>(&flags).unwrap_err().to_string();
        assert!(error.contains("f16, f32, f64 or an integer type") && error.contains("|b1"), "{error}");
        assert!(parse::<Index>(&flags).is_err());
        let error = parse::<Index>(&bytes([1_i64, -1])).unwrap_err().to_string();
        assert!(error.contains("below 0"), "{error}");
        assert_eq!(parse::<Index>(&bytes([0, u64::MAX])).unwrap()[1], Index(u64::MAX));
    }
}
