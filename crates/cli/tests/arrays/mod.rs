//! Arrays as NumPy stores them, byte by byte, by no code of the program.

/// The type of an element.
pub trait Element {
    /// NumPy's name for it.
    const NAME: &'static str;

    /// Appends its bytes.
    fn append(self, bytes: &mut Vec<u8>);
}

macro_rules! numbers {
    ($($number:ty: $name:literal),*) => { $(
        impl Element for $number {
            const NAME: &'static str = $name;

            fn append(self, bytes: &mut Vec<u8>) {
                bytes.extend(self.to_le_bytes());
            }
        }
    )* };
}

numbers!(half::f16: "<f2", f32: "<f4", f64: "<f8", i16: "<i2", i32: "<i4", i64: "<i8", u32: "<u4", u64: "<u8");

impl Element for bool {
    const NAME: &'static str = "|b1";

    fn append(self, bytes: &mut Vec<u8>) {
        bytes.push(self.into());
    }
}

/// The content of a `.npy` file.
pub fn npy<T: Element>(shape: &[u64], data: impl IntoIterator<Item = T>) -> Vec<u8> {
    let sides: Vec<String> = shape.iter().map(u64::to_string).collect();
    // Python's tuple of one.
    let comma = if sides.len() == 1 { "," } else { "" };
    let header =
        format!("{{'descr': '{}', 'fortran_order': False, 'shape': ({}{comma}), }}\n", T::NAME, sides.join(", "));
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    data.into_iter().for_each(|value| value.append(&mut bytes));
    bytes
}
