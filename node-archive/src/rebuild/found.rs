//! A file of the folder of images that may be a frame's: its header, the hash of its pixels, and the row of the database
//! that it proves.

use std::fs::{self, File};
use std::io::{self, Read, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use config::header::{HeaderTable, Source};
use config::{Observatory, Place};
use contract::CommandId;
use contract::device::camera::{Frame, Pixel, Purpose};
use sha2::{Digest as _, Sha256};
use units::{Angle, Utc};

use crate::astronomy;
use crate::card::{Card, CardValue};
use crate::database::StoredImage;
use crate::delivery::hash::hex;
use crate::fits::Shape;
use crate::folder::relative_text as relative;
use crate::header::with_names;
use crate::stored_header::Header;

/// Bytes of pixels that are hashed in one go.
const CHUNK: usize = 1 << 20;

/// The facts of a file's header about its frame.
pub(super) struct Found {
    header: Header,
    pub(super) shape: Shape,
    /// Of the pixels as they lay in the spool.
    pub(super) sha256: String,
    pub(super) bytes: u64,
}

impl Found {
    /// Whether a keyword has the text that this site's table has for it.
    fn has(&self, table: &HeaderTable, keyword: &str, place: &Place, camera: &str) -> bool {
        let source = table.rows.iter().find(|row| row.keyword == keyword).map(|row| &row.source);
        let Some(Source::Static(text)) = source else { return false };
        let written = Card::new(keyword, CardValue::Text(with_names(text, place, camera)), "").record();
        let is_written = |record: String| self.header.cards().any(|card| card.starts_with(record.trim_end()));
        !text.is_empty() && written.is_some_and(is_written)
    }

    /// The row of this telescope's frame, and whether its header is complete; `None` for a frame of another telescope.
    pub(super) fn row(
        self,
        config: &Observatory,
        table: &HeaderTable,
        id: CommandId,
        path: PathBuf,
    ) -> Option<(StoredImage, bool)> {
        let text = |keyword: &str| self.header.value(keyword).filter(|text| !text.is_empty());
        // JSON has no other numbers, and one frame that cannot be read back would hide all others.
        let number = |keyword: &str| text(keyword)?.parse::<f64>().ok().filter(|number| number.is_finite());
        let time = |keyword: &str| format!("{}Z", text(keyword)?.trim_end_matches('Z')).parse::<Utc>().ok();
        let place = &config.place;
        let telescope = text("TELESCOP");
        let is_own = |name: &String| {
            name == place.telescope.as_str()
                || *name == place.telescope_in_network()
                || config.camera.iter().any(|camera| self.has(table, "TELESCOP", place, camera.common.name.as_str()))
        };
        if telescope.as_ref().is_some_and(|telescope| !is_own(telescope)) {
            return None;
        }
        let instrument = text("INSTRUME");
        let is_named = |name: &str| {
            instrument.as_ref().is_some_and(|given| given == name || *given == place.camera_in_network(name))
                || self.has(table, "INSTRUME", place, name)
        };
        let mut named = config.camera.iter().filter(|camera| is_named(camera.common.name.as_str()));
        let camera = match (named.next(), named.next(), config.camera.as_slice()) {
            (Some(camera), None, _) => camera,
            // A device or a schedule may have named it.
            (None, _, [only]) if telescope.is_some() => only,
            _ => return None,
        };
        let started_utc = time("DATE-OBS")?;
        let night = sky::night_date(Angle::from_degrees(config.place.longitude_deg), started_utc).to_string();
        let purpose = Purpose {
            action: text("ASTRATYP").unwrap_or_default(),
            object: text("OBJECT"),
            image_type: text("IMAGETYP").unwrap_or_default(),
            filter: text("FILTER"),
            ra_deg: number("OBJALT").and_then(|_| number("RA")),
            dec_deg: number("OBJALT").and_then(|_| number("DEC")),
            night: text("NIGHT").filter(|text| is_date(text)).unwrap_or(night),
            row: text("SCHEDROW").and_then(|row| row.parse().ok()),
            programme: text("PROGID"),
            ..Purpose::default()
        };
        let frame = Frame {
            id,
            camera: camera.common.name.to_string(),
            purpose,
            width_px: self.shape.width_px,
            height_px: self.shape.height_px,
            planes: self.shape.planes,
            pixel: self.shape.pixel,
            bin: number("XBINNING").map_or(1, |bin| bin as u32),
            origin_px: ["XORGSUBF", "YORGSUBF"].map(|first| number(first).map_or(0, |px| px as u32)),
            started_utc,
            exposure_s: number("EXPTIME").unwrap_or_default(),
            url: String::new(),
            bytes: self.shape.bytes()? as u64,
            sha256: self.sha256,
            readings: std::collections::BTreeMap::new(),
        };
        let present = self.header.keywords();
        let is_complete = astronomy::KEYWORDS.iter().any(|keyword| present.contains(*keyword))
            || present.contains("OBJALT")
            || self.header.cards().any(|card| card.starts_with("HISTORY not known at DATE-OBS"));
        let stored = time("DATE").unwrap_or(started_utc);
        let file = relative(&config.folders.images, &path);
        Some((StoredImage { frame, file, bytes: self.bytes, stored }, is_complete))
    }
}

/// Whether a text is a night as [`Purpose::night`] has it; a site's own table may write something else under NIGHT.
fn is_date(text: &str) -> bool {
    text.len() == 8 && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Reads a file that this archive may have written; `None` where its shape is not one of ours.
pub(super) fn read(images: &Path, path: &Path) -> io::Result<Option<Found>> {
    crate::folder::without_links(images, path)?;
    let Some(header) = Header::read(path)? else { return Ok(None) };
    let bytes = fs::metadata(path)?.len();
    let restored = if header.is_tiled() { fits::restore::plain_file(path).map_err(io::Error::other)? } else { None };
    let header = header.plain();
    let Some(shape) = shape(&header) else { return Ok(None) };
    let Some(length) = shape.bytes() else { return Ok(None) };
    let first = header.length() as u64;
    if restored.as_ref().map_or(bytes, |plain| plain.len() as u64) < first + length as u64 {
        return Ok(None);
    }
    let sha256 = match restored {
        Some(plain) => hash(&mut &plain[header.length()..], shape.pixel, length)?,
        None => {
            let mut file = File::open(path)?;
            file.seek(SeekFrom::Start(first))?;
            hash(&mut file, shape.pixel, length)?
        }
    };
    Ok(Some(Found { header, shape, sha256, bytes }))
}

fn shape(header: &Header) -> Option<Shape> {
    let number = |keyword: &str| header.value(keyword)?.parse::<f64>().ok();
    let count = |keyword: &str| header.value(keyword)?.parse::<u32>().ok().filter(|count| *count > 0);
    let offset = number("BZERO").unwrap_or(0.0);
    let pixel = match (header.value("BITPIX")?.parse::<i64>().ok()?, offset) {
        (16, 32768.0) => Pixel::U16,
        (32, 0.0) => Pixel::I32,
        (-64, 0.0) => Pixel::F64,
        _ => return None,
    };
    let planes = match count("NAXIS")? {
        2 => 1,
        3 => count("NAXIS3")?,
        _ => return None,
    };
    Some(Shape { pixel, width_px: count("NAXIS1")?, height_px: count("NAXIS2")?, planes })
}

/// The hash of the pixels as they lay in the spool, little endian, from those of a FITS file, most significant byte
/// first.
fn hash(file: &mut impl Read, pixel: Pixel, length: usize) -> io::Result<String> {
    let (mut hasher, mut chunk, mut left) = (Sha256::new(), vec![0; CHUNK], length);
    while left > 0 {
        let part = &mut chunk[..left.min(CHUNK)];
        file.read_exact(part)?;
        for value in part.chunks_exact_mut(pixel.bytes()) {
            if pixel == Pixel::U16 {
                // BZERO 32768: counts without sign are stored as numbers with one.
                value[0] ^= 0x80;
            }
            value.reverse();
        }
        hasher.update(&*part);
        left -= part.len();
    }
    Ok(hex(&hasher.finalize()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rebuild::tests::TWO_CAMERAS;

    /// A file with these names of telescope and camera.
    fn found(telescope: &str, instrument: &str) -> Found {
        let text = |keyword: &str, text: &str| Card::new(keyword, text.into(), "a comment").record().unwrap();
        let number = |keyword: &str, number: i64| Card::new(keyword, CardValue::Int(number), "").record().unwrap();
        let cards = [
            Card::new("SIMPLE", true.into(), "").record().unwrap(),
            number("NAXIS", 2),
            text("TELESCOP", telescope),
            text("INSTRUME", instrument),
            text("DATE-OBS", "2026-11-21T03:00:00.5"),
            number("XBINNING", 2),
            number("XORGSUBF", 64),
            number("YORGSUBF", 32),
            format!("{:<80}", "END"),
        ];
        let header = Header::read_from(format!("{:<2880}", cards.concat()).as_bytes()).unwrap().unwrap();
        let shape = Shape { pixel: Pixel::U16, width_px: 4, height_px: 2, planes: 1 };
        Found { header, shape, sha256: String::new(), bytes: 5760 }
    }

    #[test]
    fn frames_are_known_by_what_the_sites_own_table_writes_for_telescope_and_camera() {
        let folder = Path::new("/images");
        let config = config::parse(&format!("{}{TWO_CAMERAS}", test_support::PARANAL), folder).unwrap();
        let own = "header,dtype,fixed,device_type,device_command,comment\n\
                   TELESCOP,str,true,static,SPC O'Neil,\nINSTRUME,str,true,static,Andor {camera},\n";
        let (own, default): (HeaderTable, _) = (own.parse().unwrap(), HeaderTable::default());
        let row = |table: &HeaderTable, telescope: &str, instrument: &str| {
            let path = folder.join("a.fits");
            found(telescope, instrument)
                .row(&config, table, CommandId("f".to_owned()), path)
                .map(|(image, _)| image.frame)
        };
        let camera = |table: &HeaderTable, telescope: &str, instrument: &str| {
            row(table, telescope, instrument).map(|frame| frame.camera)
        };
        let named = |name: &str| Some(name.to_owned());
        assert_eq!(camera(&own, "SPC O'Neil", "Andor red"), named("red"));
        assert_eq!(camera(&default, "paranal-callisto", "paranal-callisto-blue"), named("blue"));
        assert_eq!(camera(&own, "callisto", "blue"), named("blue"), "from before the site had a table of its own");
        for (telescope, instrument) in [("SPC O'Neill", "Andor red"), ("SPC O'Neil", "Andor green"), ("europa", "blue")]
        {
            assert_eq!(camera(&own, telescope, instrument), None, "{telescope}, {instrument}");
        }
        let frame = row(&own, "SPC O'Neil", "Andor blue").unwrap();
        assert_eq!((frame.bin, frame.origin_px), (2, [64, 32]));
    }
}
