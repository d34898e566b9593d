//! A list that never moves what it holds, for access in no order.

use std::marker::PhantomData;
use std::ops::Range;

use bytemuck::{Pod, cast_slice, from_bytes, from_bytes_mut};
use memmap2::MmapMut;

/// Items of the first mapping, whose pages are small: of sums 2 or 3.5 MiB. Half a page is spare in each partition.
const FIRST_ITEMS: usize = 1 << 16;
/// Items of every further mapping: of sums four or seven large pages.
const FURTHER_ITEMS: usize = 1 << 18;
/// Bytes of a small and of a large page.
const SMALL_PAGE: usize = 4 << 10;
const LARGE_PAGE: usize = 2 << 20;

/// Items, one after the other.
///
/// They lie in mappings of their own, because memory of the heap that one thread frees is not always there for the
/// others: sums on the heap took up to a fifth more on a busy machine. For all mappings but the first, the system is
/// asked for pages of 2 MiB: access is random, and with pages of 4 KiB clearing and finding them took a quarter of a
/// run at fine levels. What was never touched takes no memory (on Linux).
#[derive(Debug)]
pub struct PagedList<T> {
    mappings: Vec<MmapMut>,
    len: usize,
    items: PhantomData<T>,
}

impl<T> Default for PagedList<T> {
    fn default() -> Self {
        Self { mappings: Vec::new(), len: 0, items: PhantomData }
    }
}

impl<T: Pod> PagedList<T> {
    pub fn len(&self) -> usize {
        self.len
    }

    /// Appends an item and returns its slot.
    pub fn push(&mut self, item: T) -> u32 {
        let (mapping, _) = place(self.len);
        if mapping == self.mappings.len() {
            self.mappings.push(mapped::<T>(mapping));
        }
        let slot = self.len as u32;
        self.len += 1;
        // Written before it is read: to read a page that was never written takes a page of its own.
        *self.get_mut(slot) = item;
        slot
    }

    #[inline]
    pub fn get(&self, slot: u32) -> &T {
        let (mapping, at) = place(slot as usize);
        from_bytes(&self.mappings[mapping][bytes_of::<T>(at)])
    }

    #[inline]
    pub fn get_mut(&mut self, slot: u32) -> &mut T {
        let (mapping, at) = place(slot as usize);
        from_bytes_mut(&mut self.mappings[mapping][bytes_of::<T>(at)])
    }

    /// All items in order, piece by piece.
    pub fn slices(&self) -> impl Iterator<Item = &[T]> {
        self.used().map(|(mapping, used)| cast_slice(&mapping[..used]))
    }

    /// Every mapping with the number of its bytes that hold items.
    fn used(&self) -> impl Iterator<Item = (&MmapMut, usize)> {
        let mut left = self.len * size_of::<T>();
        self.mappings.iter().map(move |mapping| {
            let here = left.min(mapping.len());
            left -= here;
            (mapping, here)
        })
    }

    /// Bytes that are taken: those up to the last page that was touched.
    pub fn memory(&self) -> usize {
        self.len * size_of::<T>() + self.spare()
    }

    /// Of these, the bytes that no item uses yet.
    pub fn spare(&self) -> usize {
        let unused = |(n, (_, used)): (usize, (&MmapMut, usize))| used.next_multiple_of(page(n)) - used;
        self.used().enumerate().map(unused).sum()
    }
}

impl<T: Pod> Clone for PagedList<T> {
    fn clone(&self) -> Self {
        let copy = |(n, (from, used)): (usize, (&MmapMut, usize))| {
            let mut to = mapped::<T>(n);
            to[..used].copy_from_slice(&from[..used]);
            to
        };
        Self { mappings: self.used().enumerate().map(copy).collect(), ..*self }
    }
}

/// Expected bytes that are unused at the end of a list of `len` items: half a page.
pub fn expected_spare(len: usize) -> usize {
    if len > FIRST_ITEMS { LARGE_PAGE / 2 } else { SMALL_PAGE / 2 }
}

/// The mapping in which a slot lies, and its place there.
#[inline]
fn place(slot: usize) -> (usize, usize) {
    match slot.checked_sub(FIRST_ITEMS) {
        None => (0, slot),
        Some(slot) => (1 + slot / FURTHER_ITEMS, slot % FURTHER_ITEMS),
    }
}

/// Where an item lies in its mapping.
#[inline]
fn bytes_of<T>(at: usize) -> Range<usize> {
    at * size_of::<T>()..(at + 1) * size_of::<T>()
}

/// Bytes of a page of mapping `n`.
fn page(n: usize) -> usize {
    if n == 0 { SMALL_PAGE } else { LARGE_PAGE }
}

/// Mapping `n`, all zeros.
///
/// # Panics
/// If there is no memory.
fn mapped<T>(n: usize) -> MmapMut {
    let items = if n == 0 { FIRST_ITEMS } else { FURTHER_ITEMS };
    let bytes = MmapMut::map_anon(items * size_of::<T>()).expect("memory for sums");
    // Where there are no large pages, small ones do.
    #[cfg(target_os = "linux")]
    let _ = bytes.advise(if n == 0 { memmap2::Advice::NoHugePage } else { memmap2::Advice::HugePage });
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::posterior::{DiagonalSums, Sums, VertexSums};

    #[test]
    fn items_stay_where_they_are_from_one_mapping_to_the_next() {
        stays(|i| VertexSums::new([i as f64; 6], i as u32));
        stays(|i| DiagonalSums::of_ray([i as f64; 3]));
        stays(|i| [i as u32; 8]);
    }

    fn stays<T: Pod + PartialEq + std::fmt::Debug>(item: impl Fn(usize) -> T) {
        let mut list = PagedList::default();
        let count = FIRST_ITEMS + FURTHER_ITEMS + 5;
        for i in 0..count {
            let slot = list.push(item(i + 1));
            assert_eq!((slot as usize, *list.get(slot)), (i, item(i + 1)));
            *list.get_mut(slot) = item(i);
        }
        assert!((0..count).all(|i| *list.get(i as u32) == item(i)));
        assert!(list.slices().flatten().copied().eq((0..count).map(item)));
        assert!(list.clone().slices().eq(list.slices()) && list.len() == count);
        // The first two are whole multiples of their pages, the third has one.
        assert_eq!(list.memory(), (FIRST_ITEMS + FURTHER_ITEMS) * size_of::<T>() + LARGE_PAGE);
        assert_eq!((FIRST_ITEMS * size_of::<T>()) % SMALL_PAGE + (FURTHER_ITEMS * size_of::<T>()) % LARGE_PAGE, 0);
    }

    #[test]
    fn so_much_room_is_spare_in_the_mean() {
        let mut list = PagedList::default();
        // Few sums in small pages, then many in large ones; the numbers have no common divisor with either.
        for (lists, step) in [(60, 1_009), (40, 7_919)] {
            let (mut spare, mut expected) = (0, 0);
            for _ in 0..lists {
                for _ in 0..step {
                    list.push(VertexSums::default());
                }
                spare += list.spare();
                expected += expected_spare(list.len());
            }
            assert!((spare as f64 / expected as f64 - 1.0).abs() < 0.15, "{spare}, {expected} expected");
        }
    }
}
