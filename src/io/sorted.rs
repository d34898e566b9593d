//! A file of records in the order of their keys, which is written once and then read from anywhere.
//!
//! ```text
//! pages    of up to 2,048 records: their keys (u64), their items
//! index    the first key of every page (u64), and its CRC-32 (u32)
//! 28 bytes magic, number of records (u64), bytes of an item (u64), CRC-32 of the index and of all these
//! ```
//!
//! Numbers are little-endian. A reader holds one page, so that many files can be read at once.

use std::fs::File;
use std::io::{BufWriter, Read, Seek, SeekFrom, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::AtomicFile;
use super::container::Item;
use crate::{Error, Result};

/// Records of a page: large enough that reading from a disk is sequential, small enough that a page of each of many
/// files fits into a cache.
const PAGE: usize = 2048;
const MAGIC: &[u8; 8] = b"OCTORUN\n";
/// Bytes of a page in the index.
const OF_PAGE: usize = 12;
/// Bytes behind the index.
const END: usize = 28;

/// What appends a record, whose key is larger than that before.
pub type Push<'a, T> = &'a mut dyn FnMut(u64, T) -> Result<()>;

/// Pages of records as they are written.
struct Pages<'a, T, W> {
    out: W,
    path: &'a Path,
    keys: Vec<u64>,
    items: Vec<T>,
    bytes: Vec<u8>,
    index: Index,
    count: u64,
}

/// Finds the pages, and checks what they hold.
#[derive(Debug, Default)]
struct Index {
    /// The first key of every page.
    first: Vec<u64>,
    /// The CRC-32 of every page.
    checksums: Vec<u32>,
}

impl<T: Item, W: Write> Pages<'_, T, W> {
    fn push(&mut self, key: u64, item: T) -> Result<()> {
        debug_assert!(self.keys.last().is_none_or(|last| *last < key), "keys grow");
        if self.keys.len() == PAGE {
            self.end_page()?;
        }
        self.keys.push(key);
        self.items.push(item);
        Ok(())
    }

    fn end_page(&mut self) -> Result<()> {
        let Some(&first) = self.keys.first() else { return Ok(()) };
        self.count += self.keys.len() as u64;
        self.bytes.clear();
        self.keys.drain(..).for_each(|key| key.put(&mut self.bytes));
        self.items.drain(..).for_each(|item| item.put(&mut self.bytes));
        self.index.first.push(first);
        self.index.checksums.push(crc32fast::hash(&self.bytes));
        self.out.write_all(&self.bytes).map_err(Error::io(self.path, "cannot write"))
    }
}

/// Writes the records that `fill` pushes, and what finds them. Returns that, the number of records and the checksum.
fn write<T: Item>(out: impl Write, path: &Path, fill: impl FnOnce(Push<T>) -> Result<()>) -> Result<(Index, u64, u32)> {
    let (keys, items) = (Vec::with_capacity(PAGE), Vec::with_capacity(PAGE));
    let mut pages = Pages { out, path, keys, items, bytes: Vec::new(), index: Index::default(), count: 0 };
    fill(&mut |key, item| pages.push(key, item))?;
    pages.end_page()?;
    let Pages { mut out, index, count, .. } = pages;
    let end = end(&index, count, T::SIZE);
    out.write_all(&end).and_then(|()| out.flush()).map_err(Error::io(path, "cannot write"))?;
    Ok((index, count, u32::take(&end[end.len() - 4..])))
}

/// What stands behind the pages.
fn end(index: &Index, count: u64, item: usize) -> Vec<u8> {
    let mut end = Vec::with_capacity(OF_PAGE * index.first.len() + END);
    index.first.iter().for_each(|key| key.put(&mut end));
    index.checksums.iter().for_each(|checksum| checksum.put(&mut end));
    end.extend(MAGIC);
    count.put(&mut end);
    (item as u64).put(&mut end);
    crc32fast::hash(&end).put(&mut end);
    end
}

/// Records sorted by key in a file. Memory holds the first key of every page.
#[derive(Debug)]
pub struct SortedFile<T> {
    file: Mutex<File>,
    path: PathBuf,
    index: Index,
    count: u64,
    checksum: u32,
    items: PhantomData<T>,
}

impl<T: Item> SortedFile<T> {
    /// Writes a file without a name in `folder`. It goes with the process, however that ends.
    pub fn temporary(folder: &Path, fill: impl FnOnce(Push<T>) -> Result<()>) -> Result<Self> {
        let file = tempfile::tempfile_in(folder).map_err(Error::io(folder, "cannot create a file in this folder"))?;
        let (index, count, checksum) = write(BufWriter::with_capacity(1 << 20, &file), folder, fill)?;
        Ok(Self { file: Mutex::new(file), path: folder.into(), index, count, checksum, items: PhantomData })
    }

    /// Writes a file that stays, and appears complete or not at all.
    pub fn kept(path: &Path, fill: impl FnOnce(Push<T>) -> Result<()>) -> Result<Self> {
        let mut file = AtomicFile::create(path)?;
        let (_, _, checksum) = write(&mut file, path, fill)?;
        file.commit()?;
        Self::open(path, checksum)
    }

    /// Opens a file that was [kept](Self::kept), if it has this checksum.
    pub fn open(path: &Path, checksum: u32) -> Result<Self> {
        let mut file = super::open(path)?;
        let other = |found: &str| Error::malformed(path, "run of sums", "the file that the checkpoint names", found);
        let cannot_read = || Error::io(path, "cannot read");
        let length = file.metadata().map_err(cannot_read())?.len();
        let mut tail = [0; END];
        let at = length.checked_sub(END as u64).ok_or_else(|| other("a file that ends early"))?;
        file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(&mut tail)).map_err(cannot_read())?;
        let [count, size] = [8, 16].map(|at| u64::take(&tail[at..]));
        let pages = count.div_ceil(PAGE as u64);
        let whole = count.checked_mul(8 + T::SIZE as u64).and_then(|bytes| bytes.checked_add(OF_PAGE as u64 * pages));
        if &tail[..8] != MAGIC || size != T::SIZE as u64 || whole.is_none_or(|bytes| bytes != at) {
            return Err(other("another file"));
        }
        // Its length was checked, so this allocates no more than the file holds.
        let mut bytes = vec![0; OF_PAGE * pages as usize];
        let begin = SeekFrom::Start(at - bytes.len() as u64);
        file.seek(begin).and_then(|_| file.read_exact(&mut bytes)).map_err(cannot_read())?;
        let (first, checksums) = bytes.split_at(8 * pages as usize);
        let first = first.chunks_exact(8).map(u64::take).collect();
        let index = Index { first, checksums: checksums.chunks_exact(4).map(u32::take).collect() };
        let is_own =
            u32::take(&tail[24..]) == checksum && end(&index, count, T::SIZE).ends_with(&checksum.to_le_bytes());
        if !is_own || !index.first.is_sorted_by(|a, b| a < b) {
            return Err(other("altered data"));
        }
        Ok(Self { file: Mutex::new(file), path: path.into(), index, count, checksum, items: PhantomData })
    }

    /// Whether a file is one of these, of whatever items.
    #[must_use]
    pub fn is_sorted_file(path: &Path) -> bool {
        let end = File::open(path).and_then(|mut file| {
            let mut end = [0; END];
            file.seek(SeekFrom::End(-(END as i64))).and_then(|_| file.read_exact(&mut end)).map(|()| end)
        });
        end.is_ok_and(|end| end.starts_with(MAGIC))
    }

    /// Its size on disk.
    pub fn bytes(&self) -> u64 {
        self.count * (8 + T::SIZE as u64) + (OF_PAGE * self.index.first.len() + END) as u64
    }

    /// Where the file is, or its folder if it has no name.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Identifies what the file holds, all its items included.
    pub fn checksum(&self) -> u32 {
        self.checksum
    }

    /// The first key of every page.
    pub fn first_keys(&self) -> &[u64] {
        &self.index.first
    }

    /// A cursor before the first record whose key is `from` or more.
    pub fn cursor(&self, from: u64) -> Result<Cursor<'_, T>> {
        let mut cursor = Cursor { file: self, page: usize::MAX, at: 0, keys: Vec::new(), bytes: Vec::new() };
        if self.count > 0 {
            cursor.read(self.page_of(from))?;
            cursor.at = cursor.keys.partition_point(|key| *key < from);
        }
        Ok(cursor)
    }

    /// The only page that can hold a key.
    fn page_of(&self, key: u64) -> usize {
        self.index.first.partition_point(|first| *first <= key).saturating_sub(1)
    }

    /// Reads a page into `bytes`.
    fn read(&self, page: usize, bytes: &mut Vec<u8>) -> Result<()> {
        let records = (self.count - (page * PAGE) as u64).min(PAGE as u64) as usize;
        bytes.resize(records * (8 + T::SIZE), 0);
        let at = page as u64 * (PAGE * (8 + T::SIZE)) as u64;
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let read = file.seek(SeekFrom::Start(at)).and_then(|_| file.read_exact(bytes));
        drop(file);
        read.map_err(Error::io(&self.path, "cannot read"))?;
        if crc32fast::hash(bytes) == self.index.checksums[page] && u64::take(bytes) == self.index.first[page] {
            return Ok(());
        }
        let place = format!("page {page} of a run of sums");
        Err(Error::malformed(&self.path, place, "its stored checksum", "altered data"))
    }
}

/// A place in a [`SortedFile`].
#[derive(Debug)]
pub struct Cursor<'a, T> {
    file: &'a SortedFile<T>,
    page: usize,
    /// The next record of the page.
    at: usize,
    keys: Vec<u64>,
    /// The page: keys, then items, which are read one by one.
    bytes: Vec<u8>,
}

impl<T: Item> Cursor<'_, T> {
    fn read(&mut self, page: usize) -> Result<()> {
        self.file.read(page, &mut self.bytes)?;
        let records = self.bytes.len() / (8 + T::SIZE);
        self.keys.clear();
        self.keys.extend(self.bytes[..8 * records].chunks_exact(8).map(u64::take));
        (self.page, self.at) = (page, 0);
        Ok(())
    }

    #[inline]
    fn item(&self) -> T {
        T::take(&self.bytes[8 * self.keys.len() + T::SIZE * self.at..])
    }

    /// The key of the next record.
    #[inline]
    pub fn peek(&mut self) -> Result<Option<u64>> {
        if self.at == self.keys.len() {
            if self.page.wrapping_add(1) >= self.file.index.first.len() {
                return Ok(None);
            }
            self.read(self.page + 1)?;
        }
        Ok(Some(self.keys[self.at]))
    }

    /// The item of the record whose key was [peeked](Cursor::peek) at. The cursor goes on to the record behind it.
    #[inline]
    pub fn take(&mut self) -> T {
        let item = self.item();
        self.at += 1;
        item
    }

    /// The item of a key, if there is one. Keys that grow find it soonest.
    #[inline]
    pub fn find(&mut self, key: u64) -> Result<Option<T>> {
        if self.keys.first().is_none_or(|first| key < *first) || self.keys.last().is_none_or(|last| key > *last) {
            let page = self.file.page_of(key);
            if self.file.count == 0 || page == self.page {
                return Ok(None);
            }
            self.read(page)?;
        }
        self.seek(key);
        Ok((self.keys.get(self.at) == Some(&key)).then(|| self.item()))
    }

    /// Goes to the first record of the page whose key is `key` or more. Usually it is one of the next.
    fn seek(&mut self, key: u64) {
        if self.at > 0 && self.keys[self.at - 1] >= key {
            self.at = 0;
        }
        let (mut low, mut step) = (self.at, 1);
        while self.keys.get(low + step).is_some_and(|other| *other < key) {
            low += step;
            step *= 2;
        }
        let high = (low + step).min(self.keys.len());
        self.at = low + self.keys[low..high].partition_point(|other| *other < key);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use proptest::prelude::*;

    use super::*;

    fn written(path: &Path, records: &BTreeMap<u64, u32>) -> SortedFile<u32> {
        SortedFile::kept(path, |push| records.iter().try_for_each(|(key, item)| push(*key, *item))).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn records_are_found_from_anywhere(
            count in 0_u64..9000, stride in 1_u64..5, asked in proptest::collection::vec(0_u64..40_000, 200),
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("run");
            let records: BTreeMap<u64, u32> = (0..count).map(|i| (3 + i * stride, (i ^ 0x55) as u32)).collect();
            let kept = written(&path, &records);
            let fill = |push: Push<u32>| records.iter().try_for_each(|(key, item)| push(*key, *item));
            let temporary = SortedFile::temporary(folder.path(), fill).unwrap();
            prop_assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "the temporary file has no name");
            for file in [&kept, &temporary] {
                prop_assert_eq!(file.bytes(), std::fs::metadata(&path).unwrap().len());
                prop_assert_eq!(file.first_keys().len(), (count as usize).div_ceil(PAGE));
                let mut finder = file.cursor(0).unwrap();
                for key in &asked {
                    prop_assert_eq!(finder.find(*key).unwrap(), records.get(key).copied());
                }
                let mut cursor = file.cursor(asked[0]).unwrap();
                for (key, item) in records.range(asked[0]..) {
                    prop_assert_eq!(cursor.peek().unwrap(), Some(*key));
                    prop_assert_eq!(cursor.take(), *item);
                }
                prop_assert_eq!(cursor.peek().unwrap(), None);
            }
        }
    }

    #[test]
    fn altered_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run");
        let records = (0..5000).map(|i| (7 * i, i as u32)).collect();
        let checksum = written(&path, &records).checksum();
        let whole = std::fs::read(&path).unwrap();
        let reads = |bytes: &[u8]| -> Result<u64> {
            std::fs::write(&path, bytes).unwrap();
            let file = SortedFile::<u32>::open(&path, checksum)?;
            let (mut cursor, mut read) = (file.cursor(0)?, 0);
            while cursor.peek()?.is_some() {
                cursor.take();
                read += 1;
            }
            Ok(read)
        };
        assert_eq!(reads(&whole).unwrap(), 5000);
        for at in (0..whole.len()).step_by(97).chain(whole.len() - END - 36..whole.len()) {
            let mut altered = whole.clone();
            altered[at] ^= 0x10;
            assert!(reads(&altered).is_err(), "byte {at}");
        }
        for length in [0, 10, END, whole.len() / 2, whole.len() - 1] {
            assert!(reads(&whole[..length]).is_err(), "{length} bytes");
        }
        // Other keys, or other items of the same keys.
        for (key, item) in [(1, 0), (0, 1)] {
            let other = written(&path, &(0..5000).map(|i| (7 * i + key, i as u32 + item)).collect());
            assert!(SortedFile::<u32>::open(&path, checksum).is_err() && checksum != other.checksum());
        }
        let other = written(&path, &(0..5000).map(|i| (7 * i + 1, i as u32)).collect());
        assert!(SortedFile::<u64>::open(&path, other.checksum()).is_err(), "items of another size");
    }
}
