//! Binary tables (FITS Standard 4.0, section 7.3), row after row: a table of millions of stars is never in memory.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

use crate::error::{Fault, FitsError};
use crate::hdu::BLOCK;
use crate::header::Header;

/// Bytes of a header that are looked at: some 4000 cards.
const MOST_HEADER: usize = 128 * BLOCK;
/// Bytes of a row that are taken.
const MOST_ROW: u64 = 1 << 20;

/// A table that is being read.
pub struct Table {
    file: PathBuf,
    /// Its keywords.
    pub header: Header,
    columns: Vec<Column>,
    rows: u64,
    read: u64,
    row: Vec<u8>,
    source: Box<dyn BufRead>,
}

/// A column with one number or truth in each row.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// TTYPE, as written.
    pub name: String,
    /// TUNIT, as written.
    pub unit: Option<String>,
    kind: char,
    at: usize,
    scale: f64,
    zero: f64,
    null: Option<i64>,
}

impl Table {
    /// Opens the first binary table of a file, plain or packed by gzip or bzip2.
    ///
    /// # Errors
    /// [`FitsError`] when the file cannot be read, is no FITS, or holds no binary table.
    pub fn open(file: &Path) -> Result<Self, FitsError> {
        find(file).map_err(|fault| FitsError { file: file.to_owned(), fault })
    }

    /// Columns whose cells hold one number or truth; all others are passed over.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The column of a name, whatever its case.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|column| column.name.eq_ignore_ascii_case(name))
    }

    /// Number of rows.
    pub fn rows(&self) -> u64 {
        self.rows
    }

    /// Goes to the next row; its cells are read by [`Column::value`]. `None` after the last one.
    ///
    /// # Errors
    /// [`FitsError`] when the file ends before the last row, or is damaged.
    pub fn next_row(&mut self) -> Result<Option<&[u8]>, FitsError> {
        if self.read == self.rows {
            return Ok(None);
        }
        let (file, rows, read) = (&self.file, self.rows, self.read);
        self.source.read_exact(&mut self.row).map_err(|error| {
            let problem = format!("its table ends in row {} of {rows} ({error})", read + 1);
            FitsError { file: file.clone(), fault: Fault::Packed { how: "reading", detail: problem } }
        })?;
        self.read += 1;
        Ok(Some(&self.row))
    }
}

impl Column {
    /// The number in a row, scaled by TSCAL and TZERO; truth is 1 or 0. `None` where there is none (TNULL, NaN).
    pub fn value(&self, row: &[u8]) -> Option<f64> {
        let cell = row.get(self.at..)?;
        let whole = |number: i64| (self.null != Some(number)).then_some(number as f64);
        let raw = match self.kind {
            'L' => match cell.first()? {
                b'T' => return Some(1.0),
                b'F' => return Some(0.0),
                _ => None,
            },
            'B' => whole(i64::from(*cell.first()?)),
            'I' => whole(i64::from(i16::from_be_bytes(*cell.first_chunk()?))),
            'J' => whole(i64::from(i32::from_be_bytes(*cell.first_chunk()?))),
            'K' => whole(i64::from_be_bytes(*cell.first_chunk()?)),
            'E' => Some(f64::from(f32::from_be_bytes(*cell.first_chunk()?))),
            _ => Some(f64::from_be_bytes(*cell.first_chunk()?)),
        };
        raw.map(|raw| raw * self.scale + self.zero).filter(|value| value.is_finite())
    }
}

fn find(file: &Path) -> Result<Table, Fault> {
    let mut source = unpacked(file)?;
    if !source.fill_buf()?.starts_with(b"SIMPLE") {
        return Err(not_fits());
    }
    let mut found = Vec::new();
    for number in 1.. {
        if source.fill_buf()?.is_empty() {
            break;
        }
        let header = header(file, number, &mut source)?;
        if header.text("XTENSION").is_ok_and(|kind| kind == "BINTABLE") && header.logical("ZIMAGE") != Ok(true) {
            return table(file, number, header, source);
        }
        found.push(header.text("XTENSION").unwrap_or("an image").to_owned());
        let length = data_length(&header).ok_or_else(|| broken(number, "its length makes no sense"))?;
        let passed = std::io::copy(&mut (&mut source).take(length), &mut std::io::sink())?;
        if passed < length {
            return Err(Fault::CutShort { hdu: number, expected: length, found: passed });
        }
    }
    Err(Fault::NoTable { found: found.join(", ") })
}

fn table(file: &Path, number: usize, header: Header, source: Box<dyn BufRead>) -> Result<Table, Fault> {
    let length = |keyword: &str| {
        let length = header.whole(keyword).ok().and_then(|length| u64::try_from(length).ok());
        length.ok_or_else(|| broken(number, &format!("{keyword} is no length")))
    };
    let (width, rows) = (length("NAXIS1")?, length("NAXIS2")?);
    if width == 0 || width > MOST_ROW {
        return Err(Fault::TooLarge { what: format!("a row of its table has {width} bytes"), most: MOST_ROW });
    }
    let (mut columns, mut at) = (Vec::new(), 0);
    for n in 1..=length("TFIELDS")?.min(999) {
        let form = header.text(&format!("TFORM{n}")).map_err(|error| broken(number, &error.to_string()))?.trim();
        let digits = form.bytes().take_while(u8::is_ascii_digit).count();
        let repeat = if digits == 0 { Some(1) } else { form[..digits].parse::<u64>().ok() };
        let kind = form[digits..].chars().next().unwrap_or(' ');
        let bytes = match kind {
            'X' => repeat.map(|bits| bits.div_ceil(8)),
            _ => size(kind).and_then(|size| repeat?.checked_mul(size)),
        };
        let end = bytes.and_then(|bytes| bytes.checked_add(at)).filter(|end| *end <= width);
        let end = end.ok_or_else(|| broken(number, &format!("TFORM{n} = '{form}' does not fit in a row")))?;
        if repeat == Some(1) && "LBIJKED".contains(kind) {
            let number = |keyword: &str, or: f64| header.number(&format!("{keyword}{n}")).unwrap_or(or);
            columns.push(Column {
                name: header.text(&format!("TTYPE{n}")).unwrap_or_default().trim().to_owned(),
                unit: header.text(&format!("TUNIT{n}")).ok().map(|unit| unit.trim().to_owned()),
                kind,
                at: at as usize,
                scale: number("TSCAL", 1.0),
                zero: number("TZERO", 0.0),
                null: header.whole(&format!("TNULL{n}")).ok(),
            });
        }
        at = end;
    }
    Ok(Table { file: file.to_owned(), header, columns, rows, read: 0, row: vec![0; width as usize], source })
}

/// Bytes of one value (section 7.3.2, table 18).
fn size(kind: char) -> Option<u64> {
    match kind {
        'L' | 'B' | 'A' => Some(1),
        'I' => Some(2),
        'J' | 'E' => Some(4),
        'K' | 'D' | 'C' | 'P' => Some(8),
        'M' | 'Q' => Some(16),
        _ => None,
    }
}

fn broken(hdu: usize, problem: &str) -> Fault {
    Fault::Header { hdu, problem: problem.to_owned() }
}

fn unpacked(file: &Path) -> Result<Box<dyn BufRead>, Fault> {
    let mut plain = BufReader::new(File::open(file)?);
    let head = plain.fill_buf()?;
    Ok(if head.is_empty() {
        return Err(Fault::Empty);
    } else if head.starts_with(&[0x1f, 0x8b]) {
        Box::new(BufReader::new(flate2::bufread::MultiGzDecoder::new(plain)))
    } else if head.starts_with(b"BZh") {
        Box::new(BufReader::new(bzip2::bufread::MultiBzDecoder::new(plain)))
    } else {
        Box::new(plain)
    })
}

/// Reads the blocks of one header.
fn header(file: &Path, number: usize, source: &mut impl Read) -> Result<Header, Fault> {
    let mut bytes = Vec::new();
    while bytes.len() < MOST_HEADER {
        let start = bytes.len();
        bytes.resize(start + BLOCK, 0);
        source.read_exact(&mut bytes[start..]).map_err(|_| {
            let expected = (start + BLOCK) as u64;
            Fault::CutShort { hdu: number, expected, found: start as u64 }
        })?;
        if let Some((header, _)) = Header::read(file, &bytes) {
            return Ok(header);
        }
    }
    Err(broken(number, "expected a card END"))
}

/// Bytes of data with what fills the last block.
fn data_length(header: &Header) -> Option<u64> {
    let whole = |keyword: &str, or: u64| match header.whole(keyword) {
        Ok(value) => u64::try_from(value).ok(),
        Err(_) => Some(or),
    };
    let axes = whole("NAXIS", 0)?.min(999);
    if axes == 0 {
        return Some(0);
    }
    let values = (1..=axes).try_fold(1_u64, |product, n| product.checked_mul(whole(&format!("NAXIS{n}"), 0)?))?;
    let bits = header.whole("BITPIX").ok()?.unsigned_abs();
    let all = values.checked_add(whole("PCOUNT", 0)?)?.checked_mul(whole("GCOUNT", 1)?)?.checked_mul(bits / 8)?;
    all.div_ceil(BLOCK as u64).checked_mul(BLOCK as u64)
}

/// The keywords of a file's first part, whatever follows.
///
/// # Errors
/// [`FitsError`] when the file cannot be read or is no FITS.
pub fn primary_header(file: &Path) -> Result<Header, FitsError> {
    let read = || {
        let mut source = unpacked(file)?;
        if !source.fill_buf()?.starts_with(b"SIMPLE") {
            return Err(not_fits());
        }
        header(file, 1, &mut source)
    };
    read().map_err(|fault| FitsError { file: file.to_owned(), fault })
}

fn not_fits() -> Fault {
    Fault::NotFits { looks: "does not begin with \"SIMPLE\"; give a FITS file, plain, .gz or .bz2".to_owned() }
}
