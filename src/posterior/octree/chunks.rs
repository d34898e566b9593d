//! A list that never moves what it holds.

/// Items of every chunk. Of its memory, what was never written is not taken (on Linux).
const CHUNK: usize = 1 << 16;

/// Items, one after the other, in chunks of one size: a list that doubles takes three times the memory when it grows.
#[derive(Debug, Clone)]
pub struct ChunkedList<T> {
    chunks: Vec<Vec<T>>,
}

impl<T> Default for ChunkedList<T> {
    fn default() -> Self {
        Self { chunks: Vec::new() }
    }
}

impl<T> ChunkedList<T> {
    pub fn len(&self) -> usize {
        self.chunks.last().map_or(0, |last| (self.chunks.len() - 1) * CHUNK + last.len())
    }

    /// Appends an item and returns its slot.
    pub fn push(&mut self, item: T) -> u32 {
        let slot = self.len();
        if slot.is_multiple_of(CHUNK) {
            self.chunks.push(Vec::new());
        }
        let chunk = &mut self.chunks[slot / CHUNK];
        // The last chunk of a copy has no room yet either.
        chunk.reserve_exact(CHUNK - slot % CHUNK);
        chunk.push(item);
        slot as u32
    }

    #[inline]
    pub fn get(&self, slot: u32) -> &T {
        &self.chunks[slot as usize / CHUNK][slot as usize % CHUNK]
    }

    #[inline]
    pub fn get_mut(&mut self, slot: u32) -> &mut T {
        &mut self.chunks[slot as usize / CHUNK][slot as usize % CHUNK]
    }

    /// All items in order, chunk by chunk.
    pub fn slices(&self) -> impl Iterator<Item = &[T]> {
        self.chunks.iter().map(Vec::as_slice)
    }

    /// Bytes of the items.
    pub fn memory(&self) -> usize {
        self.len() * size_of::<T>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn items_stay_where_they_are_from_one_chunk_to_the_next() {
        let mut list = ChunkedList::default();
        let count = 2 * CHUNK + 5;
        for i in 0..count {
            let slot = list.push([i + 1; 8]);
            assert_eq!((slot as usize, *list.get(slot)), (i, [i + 1; 8]));
            *list.get_mut(slot) = [i; 8];
        }
        assert!((0..count).all(|i| *list.get(i as u32) == [i; 8]));
        assert!(list.slices().flatten().copied().eq((0..count).map(|i| [i; 8])));
        assert!(list.clone().slices().eq(list.slices()) && list.len() == count);
    }
}
