//! gzip and bzip2, told by their first bytes; and what other first bytes mean.

use std::io::{ErrorKind, Read};

use crate::error::Fault;

/// More bytes than this are not unpacked: twice the largest frame of our cameras in doubles, and no bomb fills the
/// machine.
const MOST_BYTES: u64 = 2 << 30;

/// The FITS bytes of a file.
///
/// # Errors
/// [`Fault`] when there are none, the packing is damaged, or it is something else than FITS.
pub(crate) fn unpack(bytes: Vec<u8>) -> Result<Vec<u8>, Fault> {
    let unpacked = if bytes.starts_with(&[0x1f, 0x8b]) {
        all("gzip", flate2::read::MultiGzDecoder::new(&bytes[..]))?
    } else if bytes.starts_with(b"BZh") {
        all("bzip2", bzip2::read::MultiBzDecoder::new(&bytes[..]))?
    } else {
        bytes
    };
    if unpacked.starts_with(b"SIMPLE  =") { Ok(unpacked) } else { Err(other(&unpacked)) }
}

fn all(how: &'static str, packed: impl Read) -> Result<Vec<u8>, Fault> {
    let mut unpacked = Vec::new();
    packed.take(MOST_BYTES + 1).read_to_end(&mut unpacked).map_err(|error| match error.kind() {
        ErrorKind::OutOfMemory => Fault::Unreadable(error),
        _ => Fault::Packed { how, detail: error.to_string() },
    })?;
    if unpacked.len() as u64 > MOST_BYTES {
        return Err(Fault::TooLarge { what: format!("unpacked by {how} it has more bytes"), most: MOST_BYTES });
    }
    Ok(unpacked)
}

/// What bytes are that are no FITS.
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
