//! Writes our own format from any number of stars: they are sorted by place on disk, and no more than a 192nd of the
//! sky is in memory at a time.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use imaging::catalogue::{Entry, Pieces, order_for};
use imaging::healpix;
use tempfile::TempDir;
use units::Angle;

use crate::error::CatalogueError;
use crate::reading::EPOCH_YEAR;

/// HEALPix order of the pieces that are sorted one after the other: 192 of them.
const PIECES: u8 = 2;
/// HEALPix order of the cells that show how much of the sky is covered: fields of 0.9 deg.
const COVERED: u8 = 6;
/// Bytes of a star on disk while they are sorted: five numbers.
const STAR: usize = 40;

/// Stars on their way into a catalogue.
#[derive(Debug)]
pub struct Sorter {
    out: PathBuf,
    /// In the same folder as the new file: there is room for it, and a file can be renamed into its place.
    folder: TempDir,
    pieces: Vec<Option<BufWriter<File>>>,
    covered: Vec<bool>,
    stars: u64,
}

/// A catalogue that was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Built {
    /// Stars in it: each once, also where the sources held one twice in the same words.
    pub stars: u32,
    /// HEALPix order of its cells.
    pub order: u8,
    /// Size of the file.
    pub bytes: u64,
}

impl Sorter {
    /// Begins the catalogue `out`. The file appears when it is whole ([`Sorter::finish`]); until then a folder
    /// next to it holds the stars, 40 bytes each.
    ///
    /// # Errors
    /// [`CatalogueError::File`] when nothing can be written there.
    pub fn new(out: &Path) -> Result<Self, CatalogueError> {
        let parent = out.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = tempfile::Builder::new().prefix(".starmesh-catalogue-").tempdir_in(parent);
        let folder = folder.map_err(CatalogueError::file(out))?;
        let pieces = (0..healpix::cells(PIECES)).map(|_| None).collect();
        let covered = vec![false; healpix::cells(COVERED) as usize];
        Ok(Self { out: out.to_owned(), folder, pieces, covered, stars: 0 })
    }

    /// Takes a star, at [`EPOCH_YEAR`].
    ///
    /// # Errors
    /// [`CatalogueError::File`] when the disk is full or fails.
    pub fn take(&mut self, entry: &Entry) -> Result<(), CatalogueError> {
        let piece = entry.cell(PIECES) as usize;
        if let Some(covered) = self.covered.get_mut(entry.cell(COVERED) as usize) {
            *covered = true;
        }
        let path = self.piece(piece);
        let broken = CatalogueError::file(&path);
        let Some(slot) = self.pieces.get_mut(piece) else { return Ok(()) };
        if slot.is_none() {
            *slot = Some(BufWriter::new(File::create(&path).map_err(&broken)?));
        }
        self.stars += 1;
        let numbers = [entry.ra.radians(), entry.dec.radians(), entry.pm_ra_mas, entry.pm_dec_mas, entry.mag];
        match slot {
            Some(file) => numbers.iter().try_for_each(|number| file.write_all(&number.to_le_bytes())).map_err(&broken),
            None => Ok(()),
        }
    }

    /// Sorts and writes. An older file of that name is replaced, at once and only by a whole one.
    ///
    /// # Errors
    /// [`CatalogueError`] when there is no star at all, or when the disk is full or fails.
    pub fn finish(mut self) -> Result<Built, CatalogueError> {
        if self.stars == 0 {
            return Err(CatalogueError::content(&self.out, "is not written: no star was found in what was given"));
        }
        if u32::try_from(self.stars).is_err() {
            let problem = format!("is not written: {} stars, the format holds {}", self.stars, u32::MAX);
            return Err(CatalogueError::content(&self.out, problem));
        }
        let covered = self.covered.iter().filter(|covered| **covered).count() as f64;
        let order = order_for(self.stars as usize, covered / self.covered.len() as f64);
        let whole = self.folder.path().join("whole.smcat");
        let broken = CatalogueError::file(&self.out);
        let mut pieces = Pieces::new(order, EPOCH_YEAR);
        let mut file = BufWriter::new(File::create(&whole).map_err(&broken)?);
        file.seek(SeekFrom::Start(pieces.head_length() as u64)).map_err(&broken)?;
        for number in 0..self.pieces.len() {
            let entries = self.read_back(number)?;
            let cells = 1_u64 << (2 * (order - PIECES));
            let records = pieces.add(number as u64 * cells..(number as u64 + 1) * cells, &entries);
            file.write_all(&records).map_err(&broken)?;
        }
        let finished = file.write_all(&pieces.tail()).and_then(|()| {
            file.seek(SeekFrom::Start(0))?;
            file.write_all(&pieces.head())?;
            let file = file.into_inner().map_err(std::io::IntoInnerError::into_error)?;
            file.sync_all()?;
            let bytes = file.metadata()?.len();
            std::fs::rename(&whole, &self.out)?;
            Ok(bytes)
        });
        Ok(Built { stars: pieces.stars(), order, bytes: finished.map_err(&broken)? })
    }

    fn piece(&self, number: usize) -> PathBuf {
        self.folder.path().join(format!("{number}.stars"))
    }

    fn read_back(&mut self, number: usize) -> Result<Vec<Entry>, CatalogueError> {
        let Some(mut written) = self.pieces.get_mut(number).and_then(Option::take) else { return Ok(Vec::new()) };
        let path = self.piece(number);
        let broken = CatalogueError::file(&path);
        written.flush().map_err(&broken)?;
        drop(written);
        let mut bytes = BufReader::new(File::open(&path).map_err(&broken)?);
        let count = bytes.get_ref().metadata().map_err(&broken)?.len() as usize / STAR;
        let mut entries = Vec::with_capacity(count);
        let mut star = [0; STAR];
        for _ in 0..count {
            bytes.read_exact(&mut star).map_err(&broken)?;
            let number = |n: usize| star[8 * n..].first_chunk().map_or(0.0, |bytes| f64::from_le_bytes(*bytes));
            entries.push(Entry {
                ra: Angle::from_radians(number(0)),
                dec: Angle::from_radians(number(1)),
                pm_ra_mas: number(2),
                pm_dec_mas: number(3),
                mag: number(4),
            });
        }
        drop(bytes);
        std::fs::remove_file(&path).map_err(&broken)?;
        Ok(entries)
    }
}
