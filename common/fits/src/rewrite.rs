//! A header changed in its file: the whole file is written anew next to the old one and replaces it at once, so that no
//! half-written file can be left behind, whatever fails on the way.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::Path;

use crate::error::{Fault, FitsError};
use crate::hdu;
use crate::part::{new_part, sync_folder};
use crate::unpack::{Packing, Source};

/// Changes the header of an HDU. `change` is given the file's bytes from that header on; it answers the new header, in
/// whole blocks, and how many bytes the old one took. A packed file is packed again; links are followed; the file keeps
/// its permissions.
///
/// # Errors
/// [`FitsError`] when the file cannot be read or written, is read-only, or has no such HDU.
pub fn header(file: &Path, number: usize, change: impl FnOnce(&[u8]) -> (Vec<u8>, usize)) -> Result<(), FitsError> {
    rewritten(file, number, change).map_err(|fault| FitsError { file: file.to_owned(), fault })
}

fn rewritten(file: &Path, number: usize, change: impl FnOnce(&[u8]) -> (Vec<u8>, usize)) -> Result<(), Fault> {
    // A link remains a link.
    let target = std::fs::canonicalize(file)?;
    let permissions = std::fs::metadata(&target)?.permissions();
    if permissions.readonly() {
        return Err(Fault::ReadOnly);
    }
    let opened = File::open(&target)?;
    let length = opened.metadata()?.len();
    let mut source = Source::new(opened, Some(length))?;
    let mut start = 0;
    for passed in 1..number {
        let hdu = hdu::read(file, &mut source, start, passed)?;
        let hdu = hdu.ok_or(Fault::NoSuchImage { hdu: number, images: Vec::new() })?;
        hdu.fill(&mut source)?;
        start = hdu.next();
    }
    let packing = source.fill_all()?;
    let bytes = source.into_bytes();
    let (before, old) = bytes.split_at_checked(start).unwrap_or((&bytes, &[]));
    let (new, took) = change(old);
    let behind = old.get(took..).unwrap_or_default();
    let whole = packed(packing, &[before, &new, behind])?;
    write_at_once(&target, &whole, Some(permissions))?;
    Ok(())
}

fn packed(packing: Packing, parts: &[&[u8]]) -> std::io::Result<Vec<u8>> {
    match packing {
        Packing::Plain => Ok(parts.concat()),
        Packing::Gzip => {
            let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
            parts.iter().try_for_each(|part| packer.write_all(part))?;
            packer.finish()
        }
        Packing::Bzip2 => {
            let mut packer = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            parts.iter().try_for_each(|part| packer.write_all(part))?;
            packer.finish()
        }
    }
}

/// Writes a file so that its name stands for the old bytes or for all of the new ones, never for a part of them.
///
/// # Errors
/// The error of the system; then the old file is as it was.
pub fn write_at_once(file: &Path, bytes: &[u8], permissions: Option<std::fs::Permissions>) -> std::io::Result<()> {
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let part = new_part(folder, &name);
    let written = || {
        let mut new = OpenOptions::new().write(true).create_new(true).open(&part)?;
        new.write_all(bytes)?;
        if let Some(permissions) = permissions {
            new.set_permissions(permissions)?;
        }
        new.sync_all()?;
        std::fs::rename(&part, file)?;
        sync_folder(file)
    };
    written().inspect_err(|_| {
        let _ = std::fs::remove_file(&part);
    })
}
