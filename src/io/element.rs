//! Elements of NumPy arrays: of one type, or converted from any type that holds such numbers.

use std::io::{self, Read};

use half::f16;
use npyz::{DType, DTypeError, Deserialize, TypeRead};

/// What an array is read as.
pub trait Element: Deserialize {
    /// The accepted types, in words.
    const ACCEPTED: &'static str;
}

#[cfg(test)]
impl Element for f32 {
    const ACCEPTED: &'static str = "f32";
}

/// A real number, rounded to f32: of type f16, f32, f64, or an integer of any size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Real(pub f32);

impl Element for Real {
    const ACCEPTED: &'static str = "f16, f32, f64 or an integer type";
}

impl Deserialize for Real {
    type TypeReader = RealReader;

    fn reader(dtype: &DType) -> Result<RealReader, DTypeError> {
        // The error is that of a type that is accepted.
        Scalar::from_dtype(dtype).map_or_else(|| f32::reader(dtype).map(Scalar::F32), Ok).map(RealReader)
    }
}

/// A number from 0, such as an index or a count: an integer of any size, with or without sign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Index(pub u64);

impl Element for Index {
    const ACCEPTED: &'static str = "an integer type (`.astype(\"u4\")`)";
}

impl Deserialize for Index {
    type TypeReader = IndexReader;

    fn reader(dtype: &DType) -> Result<IndexReader, DTypeError> {
        let whole = Scalar::from_dtype(dtype).filter(|scalar| !scalar.is_float());
        whole.map_or_else(|| u64::reader(dtype).map(Scalar::U64), Ok).map(IndexReader)
    }
}

/// Reads [`Real`].
pub struct RealReader(Scalar);

impl TypeRead for RealReader {
    type Value = Real;

    fn read_one<R: Read>(&self, bytes: R) -> io::Result<Real> {
        Ok(Real(match self.0.read(bytes)? {
            Number::Float(value) => value as f32,
            Number::Whole(value) => value as f32,
        }))
    }
}

/// Reads [`Index`].
pub struct IndexReader(Scalar);

impl TypeRead for IndexReader {
    type Value = Index;

    fn read_one<R: Read>(&self, bytes: R) -> io::Result<Index> {
        match self.0.read(bytes)? {
            Number::Whole(value) => u64::try_from(value).map(Index).ok(),
            Number::Float(_) => None,
        }
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "a number below 0"))
    }
}

/// A number as it is stored. Both kinds hold all values of their types exactly.
enum Number {
    Float(f64),
    Whole(i128),
}

macro_rules! scalars {
    ($($variant:ident $type:ty => $number:ident as $wide:ty),* $(,)?) => {
        /// A reader of one of the types of numbers.
        enum Scalar {
            $($variant(<$type as Deserialize>::TypeReader)),*
        }

        impl Scalar {
            /// The reader of a type, if it is a type of numbers.
            fn from_dtype(dtype: &DType) -> Option<Self> {
                $(if let Ok(reader) = <$type>::reader(dtype) {
                    return Some(Self::$variant(reader));
                })*
                None
            }

            fn read(&self, bytes: impl Read) -> io::Result<Number> {
                match self {
                    $(Self::$variant(reader) => reader.read_one(bytes).map(|v| Number::$number(<$wide>::from(v)))),*
                }
            }
        }
    };
}

scalars! {
    F32 f32 => Float as f64,
    F64 f64 => Float as f64,
    F16 f16 => Float as f64,
    I64 i64 => Whole as i128,
    I32 i32 => Whole as i128,
    I16 i16 => Whole as i128,
    I8 i8 => Whole as i128,
    U64 u64 => Whole as i128,
    U32 u32 => Whole as i128,
    U16 u16 => Whole as i128,
    U8 u8 => Whole as i128,
}

impl Scalar {
    const fn is_float(&self) -> bool {
        matches!(self, Self::F16(_) | Self::F32(_) | Self::F64(_))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use npyz::{AutoSerialize, Serialize};

    use super::*;
    use crate::io::npy::{self, ArrayStream};

    fn parse<T: Element>(bytes: &[u8]) -> crate::Result<Vec<T>> {
        Ok(ArrayStream::<T, _>::new(bytes, bytes.len() as u64, Path::new("x.npy"), "data")?.into_array()?.data)
    }

    fn bytes<T: AutoSerialize + Serialize>(values: [T; 2]) -> Vec<u8> {
        let mut bytes = Vec::new();
        npy::write_to(&mut bytes, Path::new("memory"), &[2], values).unwrap();
        bytes
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
        let mut big = bytes([1.0_f64, 100.0]);
        let end = big.len();
        let at = big.windows(3).position(|b| b == b"<f8").unwrap();
        big[at] = b'>';
        big[end - 16..end - 8].reverse();
        big[end - 8..].reverse();
        assert_eq!(parse::<Real>(&big).unwrap(), [Real(1.0), Real(100.0)]);
    }

    #[test]
    fn what_is_no_such_number_is_refused() {
        let flags = bytes([true, false]);
        let error = parse::<Real>(&flags).unwrap_err().to_string();
        assert!(error.contains("f16, f32, f64 or an integer type") && error.contains("|b1"), "{error}");
        assert!(parse::<Index>(&flags).is_err());
        let error = parse::<Index>(&bytes([1_i64, -1])).unwrap_err().to_string();
        assert!(error.contains("below 0"), "{error}");
        assert_eq!(parse::<Index>(&bytes([0, u64::MAX])).unwrap()[1], Index(u64::MAX));
    }
}
