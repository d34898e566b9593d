//! A list that never moves what it holds, for access in no order.

use bytemuck::{Pod, cast_slice, from_bytes, from_bytes_mut};
use memmap2::MmapMut;

/// Items per chunk: of sums 14 KiB. Half a chunk is spare in each partition.
const CHUNK: usize = 256;
/// Chunks that come from the heap.
const CHUNKS: usize = 256;
/// Items that they hold.
const SMALL: usize = CHUNKS * CHUNK;
/// Items in each mapping that holds those beyond: of sums, seven pages of 2 MiB.
const MAPPED: usize = 1 << 18;
/// Bytes of a large page.
const PAGE: usize = 2 << 20;

/// Items, one after the other.
///
/// The first come from the heap, chunk by chunk. Those beyond lie in mappings of their own, for which the system is
/// asked for pages of 2 MiB: access is random, and with pages of 4 KiB clearing and finding them took a quarter of a
/// run at fine levels. What was never touched takes no memory (on Linux).
#[derive(Debug)]
pub struct PagedList<T> {
    chunks: Vec<Box<[T; CHUNK]>>,
    mapped: Vec<MmapMut>,
    len: usize,
}

impl<T> Default for PagedList<T> {
    fn default() -> Self {
        Self { chunks: Vec::new(), mapped: Vec::new(), len: 0 }
    }
}

impl<T: Pod> PagedList<T> {
    /// Expected bytes that are unused at the end of a list with `bytes` bytes of items: half a chunk, or half a large
    /// page.
    pub fn expected_spare(bytes: usize) -> usize {
        if bytes > SMALL * size_of::<T>() { PAGE / 2 } else { CHUNK * size_of::<T>() / 2 }
    }

    pub fn len(&self) -> usize {
        self.len
    }

    /// Appends an item and returns its slot.
    pub fn push(&mut self, item: T) -> u32 {
        if self.len < SMALL {
            if self.len == self.chunks.len() * CHUNK {
                self.chunks.push(Box::new([T::zeroed(); CHUNK]));
            }
        } else if self.len == SMALL + self.mapped.len() * MAPPED {
            self.mapped.push(mapping::<T>());
        }
        let slot = self.len as u32;
        self.len += 1;
        // Written before it is read: to read a page that was never written takes a page of its own.
        *self.get_mut(slot) = item;
        slot
    }

    #[inline]
    pub fn get(&self, slot: u32) -> &T {
        let slot = slot as usize;
        match slot.checked_sub(SMALL) {
            None => &self.chunks[slot / CHUNK][slot % CHUNK],
            Some(slot) => from_bytes(&self.mapped[slot / MAPPED][bytes_of::<T>(slot % MAPPED)]),
        }
    }

    #[inline]
    pub fn get_mut(&mut self, slot: u32) -> &mut T {
        let slot = slot as usize;
        match slot.checked_sub(SMALL) {
            None => &mut self.chunks[slot / CHUNK][slot % CHUNK],
            Some(slot) => from_bytes_mut(&mut self.mapped[slot / MAPPED][bytes_of::<T>(slot % MAPPED)]),
        }
    }

    /// All items in order, piece by piece.
    pub fn slices(&self) -> impl Iterator<Item = &[T]> {
        let chunks = self.chunks.iter().map(|chunk| &chunk[..]);
        let mapped = self.mapped.iter().map(|bytes| cast_slice(bytes));
        let mut left = self.len;
        chunks.chain(mapped).map(move |items: &[T]| {
            let here = left.min(items.len());
            left -= here;
            &items[..here]
        })
    }

    /// Bytes that are taken: of mappings, those up to the last page that was touched.
    pub fn memory(&self) -> usize {
        self.len * size_of::<T>() + self.spare() + self.chunks.capacity() * 8
    }

    /// Of these, the bytes that no item uses yet.
    pub fn spare(&self) -> usize {
        let mapped = (self.len.saturating_sub(SMALL) * size_of::<T>()).next_multiple_of(PAGE);
        let taken = self.chunks.len() * CHUNK * size_of::<T>() + mapped;
        taken - self.len * size_of::<T>()
    }
}

impl<T: Pod> Clone for PagedList<T> {
    fn clone(&self) -> Self {
        let mut left = self.len.saturating_sub(SMALL);
        let copy = |from: &MmapMut| {
            let (mut to, here) = (mapping::<T>(), left.min(MAPPED) * size_of::<T>());
            left -= left.min(MAPPED);
            to[..here].copy_from_slice(&from[..here]);
            to
        };
        let mapped = self.mapped.iter().map(copy).collect();
        Self { chunks: self.chunks.clone(), mapped, len: self.len }
    }
}

/// Where an item lies in its mapping.
#[inline]
fn bytes_of<T>(at: usize) -> std::ops::Range<usize> {
    at * size_of::<T>()..(at + 1) * size_of::<T>()
}

/// Zeros for [`MAPPED`] items, in large pages where the system has them.
///
/// # Panics
/// If there is no memory.
fn mapping<T>() -> MmapMut {
    let bytes = MmapMut::map_anon(MAPPED * size_of::<T>()).expect("memory for sums");
    // Where there are no large pages, small ones do.
    #[cfg(target_os = "linux")]
    let _ = bytes.advise(memmap2::Advice::HugePage);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::posterior::VertexSums;

    #[test]
    fn items_stay_where_they_are_from_the_heap_into_mappings() {
        stays(|i| VertexSums::new([i as f64; 6], i as u32));
        stays(|i| [i as u32; 8]);
    }

    fn stays<T: Pod + PartialEq + std::fmt::Debug>(item: impl Fn(usize) -> T) {
        let mut list = PagedList::default();
        let count = SMALL + MAPPED + 5;
        for i in 0..count {
            let slot = list.push(item(i + 1));
            assert_eq!((slot as usize, *list.get(slot)), (i, item(i + 1)));
            *list.get_mut(slot) = item(i);
        }
        assert!((0..count).all(|i| *list.get(i as u32) == item(i)));
        assert!(list.slices().flatten().copied().eq((0..count).map(item)));
        assert!(list.clone().slices().eq(list.slices()) && list.len() == count);
        let pages = (MAPPED + 5) * size_of::<T>() / PAGE + 1;
        let chunks = SMALL * size_of::<T>() + list.chunks.capacity() * 8;
        assert_eq!(list.memory(), chunks + pages * PAGE);
        assert_eq!((MAPPED * size_of::<T>()) % PAGE, 0);
    }

    #[test]
    fn so_much_room_is_spare_in_the_mean() {
        let mut list = PagedList::default();
        // Few sums in chunks, then many in large pages; the numbers have no common divisor with either.
        for (lists, step) in [(60, 1_009), (40, 7_919)] {
            let (mut spare, mut expected) = (0, 0);
            for _ in 0..lists {
                for _ in 0..step {
                    list.push(VertexSums::default());
                }
                spare += list.spare();
                expected += PagedList::<VertexSums>::expected_spare(list.len() * size_of::<VertexSums>());
            }
            assert!((spare as f64 / expected as f64 - 1.0).abs() < 0.15, "{spare}, {expected} expected");
        }
    }
}
