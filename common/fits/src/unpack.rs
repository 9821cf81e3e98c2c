//! gzip and bzip2, recognized by their first bytes; and the meaning of other first bytes.

use std::io::{Cursor, ErrorKind, Read};

use crate::error::Fault;

/// More bytes than this are not read of one file: twice the largest frame of our cameras in doubles, so that no bomb
/// fills the memory.
pub(crate) const MOST_BYTES: u64 = 2 << 30;
/// The bytes that may follow the parts that a packed file announces: other programs fill up to a tape's block.
const MOST_BEHIND: u64 = 16 << 20;
/// deflate packs a byte into a 1032nd at most (RFC 1951: 258 bytes take two bits).
const MOST_DEFLATED: u64 = 1032;

/// The bytes of a file, unpacked no further than requested: as much as a header announces, not as much as a bomb
/// contains.
pub(crate) struct Source {
    bytes: Vec<u8>,
    rest: Option<Rest>,
    packing: Packing,
}

/// The part that is not read yet.
struct Rest {
    from: Box<dyn Read>,
    packing: Packing,
    /// The most that there can be in all, where that is known.
    most: Option<u64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Packing {
    Plain,
    Gzip,
    Bzip2,
}

impl Packing {
    fn name(self) -> &'static str {
        match self {
            Self::Plain => "reading",
            Self::Gzip => "gzip",
            Self::Bzip2 => "bzip2",
        }
    }
}

impl Source {
    /// Begins a file of so many bytes, as far as that is known.
    ///
    /// # Errors
    /// [`Fault`] when there are none, the packing is damaged, or it is something else than FITS.
    pub(crate) fn new(mut from: impl Read + 'static, length: Option<u64>) -> Result<Self, Fault> {
        let mut head = Vec::new();
        (&mut from).take(HEAD).read_to_end(&mut head)?;
        let packing = match head.as_slice() {
            [0x1f, 0x8b, ..] => Packing::Gzip,
            [b'B', b'Z', b'h', ..] => Packing::Bzip2,
            _ => Packing::Plain,
        };
        let room = if packing == Packing::Plain { length.unwrap_or(0).min(MOST_BYTES) } else { 0 };
        let mut bytes = pages::with_room(usize::try_from(room).unwrap_or(0));
        let (from, most): (Box<dyn Read>, _) = match packing {
            Packing::Plain => {
                bytes.append(&mut head);
                (Box::new(from), None)
            }
            Packing::Gzip => {
                let most = length.map(|length| length.saturating_mul(MOST_DEFLATED));
                (Box::new(flate2::read::MultiGzDecoder::new(Cursor::new(head).chain(from))), most)
            }
            Packing::Bzip2 => (Box::new(bzip2::read::MultiBzDecoder::new(Cursor::new(head).chain(from))), None),
        };
        let mut source = Self { bytes, rest: Some(Rest { from, packing, most }), packing };
        source.fill(HEAD)?;
        if source.bytes.starts_with(b"SIMPLE  =") { Ok(source) } else { Err(other(&source.bytes)) }
    }

    /// The bytes that were read so far.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The bytes that were read, as a value of its own.
    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Reads on until there are so many bytes, or all there are.
    ///
    /// # Errors
    /// [`Fault::TooLarge`] before anything is read, [`Fault::Packed`] when the packing is damaged.
    pub(crate) fn fill(&mut self, to: u64) -> Result<(), Fault> {
        let have = self.bytes.len() as u64;
        let Some(rest) = self.rest.as_mut().filter(|_| to > have) else { return Ok(()) };
        if to > MOST_BYTES {
            return Err(Fault::TooLarge { what: format!("its header announces {to} bytes"), most: MOST_BYTES });
        }
        if let Some(most) = rest.most.filter(|most| to > *most) {
            let detail = format!("its header announces {to} bytes, so few packed ones hold {most} at most");
            return Err(Fault::Packed { how: rest.packing.name(), detail });
        }
        let read = (&mut rest.from).take(to - have).read_to_end(&mut self.bytes);
        let read = read.map_err(|error| fault(&error, rest.packing))?;
        if (read as u64) < to - have {
            self.rest = None;
        }
        Ok(())
    }

    /// Reads all there is, and returns how it was packed.
    ///
    /// # Errors
    /// As [`Source::fill`].
    pub(crate) fn fill_all(&mut self) -> Result<Packing, Fault> {
        if let Some(mut rest) = self.rest.take() {
            let room = (MOST_BYTES + 1).saturating_sub(self.bytes.len() as u64);
            let read = (&mut rest.from).take(room).read_to_end(&mut self.bytes);
            read.map_err(|error| fault(&error, rest.packing))?;
        }
        if self.bytes.len() as u64 > MOST_BYTES {
            return Err(Fault::TooLarge { what: "it has more bytes".to_owned(), most: MOST_BYTES });
        }
        Ok(self.packing)
    }

    /// Reads what follows the `announced` bytes, without keeping it, and so proves the sums of the packing.
    ///
    /// # Errors
    /// [`Fault::Packed`] when the packing is damaged, [`Fault::TooLarge`] when there is far more than was announced.
    pub(crate) fn finish(&mut self, announced: u64) -> Result<(), Fault> {
        let Some(mut rest) = self.rest.take().filter(|rest| rest.packing != Packing::Plain) else { return Ok(()) };
        let passed = std::io::copy(&mut (&mut rest.from).take(MOST_BEHIND + 1), &mut std::io::sink());
        if passed.map_err(|error| fault(&error, rest.packing))? <= MOST_BEHIND {
            return Ok(());
        }
        let how = rest.packing.name();
        let what = format!("unpacked by {how} it goes on behind the {announced} bytes that its headers announce");
        Err(Fault::TooLarge { what, most: announced + MOST_BEHIND })
    }
}

/// The number of bytes by which the kind of a file is recognized.
const HEAD: u64 = 2880;

fn fault(error: &std::io::Error, packing: Packing) -> Fault {
    if packing == Packing::Plain || error.kind() == ErrorKind::OutOfMemory {
        return Fault::Unreadable(std::io::Error::new(error.kind(), error.to_string()));
    }
    Fault::Packed { how: packing.name(), detail: error.to_string() }
}

/// The fault of bytes that are not FITS.
fn other(bytes: &[u8]) -> Fault {
    let head: String = bytes.iter().take(64).map(|byte| char::from(*byte)).collect();
    let is_markup = head.trim_start().starts_with('<');
    let known: [(&[u8], &str); 10] = [
        (b"\x1f\x9d", "is packed by compress (.Z); unpack it with `uncompress` first"),
        (b"\xfd7zXZ", "is packed by xz; unpack it with `unxz` first"),
        (b"\x28\xb5\x2f\xfd", "is packed by zstd; unpack it with `unzstd` first"),
        (b"PK", "is a zip archive; unpack it with `unzip` first"),
        (b"XISF", "is an XISF image; save it as FITS"),
        (b"\xff\xd8\xff", "is a JPEG image; give the camera's FITS file"),
        (b"\x89PNG", "is a PNG image; give the camera's FITS file"),
        (b"II*\0", "is a TIFF or raw image of a camera; save it as FITS"),
        (b"MM\0*", "is a TIFF or raw image of a camera; save it as FITS"),
        (b"\x1f\x8b", "is packed by gzip twice; unpack it with `gunzip` first"),
    ];
    let looks = match known.iter().find(|(first, _)| bytes.starts_with(first)) {
        _ if bytes.is_empty() => return Fault::Empty,
        Some((_, looks)) => (*looks).to_owned(),
        None if is_markup => "is a web page (HTML): the download was refused; fetch the file again".to_owned(),
        None if bytes.starts_with(b"SIMPLE") => "begins with a broken card SIMPLE; write it again".to_owned(),
        None => {
            let begins: String = bytes.iter().take(16).map(|byte| byte.escape_ascii().to_string()).collect();
            format!("begins with \"{begins}\", expected \"SIMPLE  =\"; give a FITS file, plain, .fz, .gz or .bz2")
        }
    };
    Fault::NotFits { looks }
}
