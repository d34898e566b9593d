//! A list of sums that grows without moving them.

use bytemuck::{cast_slice, from_bytes, from_bytes_mut};
use memmap2::MmapMut;

use crate::posterior::VertexSums;

/// Sums per chunk, which takes 56 KiB.
const CHUNK: usize = 1024;
/// Chunks that come from the heap.
const CHUNKS: usize = 64;
/// Sums that they hold, 3.7 MB.
const SMALL: usize = CHUNKS * CHUNK;
/// Sums in each mapping that holds those beyond: seven pages of 2 MiB.
const MAPPED: usize = 1 << 18;
/// Bytes of a large page.
const PAGE: usize = 2 << 20;

/// Expected bytes that are unused at the end of a list with sums of `bytes` bytes: half a chunk, or half a large page.
pub fn expected_spare(bytes: usize) -> usize {
    if bytes > SMALL * size_of::<VertexSums>() { PAGE / 2 } else { CHUNK * size_of::<VertexSums>() / 2 }
}

/// Sums, one after the other.
///
/// The first come from the heap, chunk by chunk. Those beyond lie in mappings of their own, for which the system is
/// asked for pages of 2 MiB: sums are touched in no order, and of many at fine levels clearing small pages and finding
/// them took a quarter of a run. What was never touched takes no memory (on Linux).
#[derive(Debug, Default)]
pub struct SumsList {
    chunks: Vec<Box<[VertexSums; CHUNK]>>,
    mapped: Vec<MmapMut>,
    len: usize,
}

impl SumsList {
    pub fn len(&self) -> usize {
        self.len
    }

    /// Appends zeros and returns their slot.
    pub fn push(&mut self) -> u32 {
        if self.len < SMALL {
            if self.len == self.chunks.len() * CHUNK {
                self.chunks.push(Box::new([VertexSums::default(); CHUNK]));
            }
        } else if self.len == SMALL + self.mapped.len() * MAPPED {
            self.mapped.push(mapping());
        }
        let slot = self.len as u32;
        self.len += 1;
        // Written before it is read: to read a page that was never written takes a page of its own.
        *self.get_mut(slot) = VertexSums::default();
        slot
    }

    #[inline]
    pub fn get(&self, slot: u32) -> &VertexSums {
        let slot = slot as usize;
        match slot.checked_sub(SMALL) {
            None => &self.chunks[slot / CHUNK][slot % CHUNK],
            Some(slot) => from_bytes(&self.mapped[slot / MAPPED][bytes_of(slot % MAPPED)]),
        }
    }

    #[inline]
    pub fn get_mut(&mut self, slot: u32) -> &mut VertexSums {
        let slot = slot as usize;
        match slot.checked_sub(SMALL) {
            None => &mut self.chunks[slot / CHUNK][slot % CHUNK],
            Some(slot) => from_bytes_mut(&mut self.mapped[slot / MAPPED][bytes_of(slot % MAPPED)]),
        }
    }

    /// All sums in order, piece by piece.
    pub fn slices(&self) -> impl Iterator<Item = &[VertexSums]> {
        let chunks = self.chunks.iter().map(|chunk| &chunk[..]);
        let mapped = self.mapped.iter().map(|bytes| cast_slice(bytes));
        let mut left = self.len;
        chunks.chain(mapped).map(move |sums: &[VertexSums]| {
            let here = left.min(sums.len());
            left -= here;
            &sums[..here]
        })
    }

    /// Bytes that are taken: of mappings, those up to the last page that was touched.
    pub fn memory(&self) -> usize {
        self.len * size_of::<VertexSums>() + self.spare() + self.chunks.capacity() * 8
    }

    /// Of these, the bytes that no sums use yet.
    pub fn spare(&self) -> usize {
        let mapped = (self.len.saturating_sub(SMALL) * size_of::<VertexSums>()).next_multiple_of(PAGE);
        let taken = self.chunks.len() * CHUNK * size_of::<VertexSums>() + mapped;
        taken - self.len * size_of::<VertexSums>()
    }
}

impl Clone for SumsList {
    fn clone(&self) -> Self {
        let mut left = self.len.saturating_sub(SMALL);
        let copy = |from: &MmapMut| {
            let (mut to, here) = (mapping(), left.min(MAPPED) * size_of::<VertexSums>());
            left -= left.min(MAPPED);
            to[..here].copy_from_slice(&from[..here]);
            to
        };
        let mapped = self.mapped.iter().map(copy).collect();
        Self { chunks: self.chunks.clone(), mapped, len: self.len }
    }
}

/// Where sums lie in their mapping.
#[inline]
fn bytes_of(at: usize) -> std::ops::Range<usize> {
    at * size_of::<VertexSums>()..(at + 1) * size_of::<VertexSums>()
}

/// Zeros for [`MAPPED`] sums, in large pages where the system has them.
///
/// # Panics
/// If there is no memory.
fn mapping() -> MmapMut {
    let bytes = MmapMut::map_anon(MAPPED * size_of::<VertexSums>()).expect("memory for the sums");
    // Where there are no large pages, small ones do.
    #[cfg(target_os = "linux")]
    let _ = bytes.advise(memmap2::Advice::HugePage);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_stay_where_they_are_from_the_heap_into_mappings() {
        let mut list = SumsList::default();
        let count = SMALL + MAPPED + 5;
        for i in 0..count {
            let slot = list.push();
            assert_eq!((slot as usize, *list.get(slot)), (i, VertexSums::default()));
            *list.get_mut(slot) = VertexSums::new([i as f64; 6], i as u32);
        }
        let expected = |i: usize| VertexSums::new([i as f64; 6], i as u32);
        assert!((0..count).all(|i| *list.get(i as u32) == expected(i)));
        assert!(list.slices().flatten().copied().eq((0..count).map(expected)));
        assert!(list.clone().slices().eq(list.slices()) && list.len() == count);
        let pages = (MAPPED + 5) * size_of::<VertexSums>() / PAGE + 1;
        let chunks = SMALL * size_of::<VertexSums>() + list.chunks.capacity() * 8;
        assert_eq!(list.memory(), chunks + pages * PAGE);
        assert_eq!((MAPPED * size_of::<VertexSums>()) % PAGE, 0);
    }

    #[test]
    fn so_much_room_is_spare_in_the_mean() {
        let mut list = SumsList::default();
        // Few sums in chunks, then many in large pages; the numbers have no common divisor with either.
        for (lists, step) in [(60, 1_009), (40, 7_919)] {
            let (mut spare, mut expected) = (0, 0);
            for _ in 0..lists {
                for _ in 0..step {
                    list.push();
                }
                spare += list.spare();
                expected += expected_spare(list.len() * size_of::<VertexSums>());
            }
            assert!((spare as f64 / expected as f64 - 1.0).abs() < 0.15, "{spare}, {expected} expected");
        }
    }
}
