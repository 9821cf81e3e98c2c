//! The primary image of a FITS file, for tests and examples: no more of the standard than they need.

use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use imaging::Pixels;

/// An image as it stands in the file.
pub struct Image {
    pub width: usize,
    pub height: usize,
    values: Values,
}

enum Values {
    Counts(Vec<u16>),
    Floats(Vec<f32>),
}

impl Image {
    pub fn pixels(&self) -> Pixels<'_> {
        match &self.values {
            Values::Counts(counts) => Pixels::U16(counts),
            Values::Floats(floats) => Pixels::F32(floats),
        }
    }
}

/// Reads a file, gzipped or plain.
pub fn read(path: &Path) -> Result<Image> {
    let bytes = std::fs::read(path).with_context(|| format!("reading {}", path.display()))?;
    let mut unpacked = Vec::new();
    if bytes.starts_with(&[0x1f, 0x8b]) {
        flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut unpacked).context("unpacking")?;
    } else {
        unpacked = bytes;
    }
    parse(&unpacked).with_context(|| format!("in {}", path.display()))
}

fn parse(bytes: &[u8]) -> Result<Image> {
    let mut cards = std::collections::HashMap::new();
    let mut data = None;
    for (n, card) in bytes.chunks_exact(80).enumerate() {
        let card = String::from_utf8_lossy(card);
        if card.trim() == "END" {
            data = bytes.get((n + 1).div_ceil(36) * 2880..);
            break;
        }
        if let Some((key, value)) = card.split_once('=') {
            let value = value.split('/').next().unwrap_or_default().trim().to_owned();
            cards.entry(key.trim().to_owned()).or_insert(value);
        }
    }
    let data = data.context("header has no END")?;
    let number = |key: &str, default: Option<f64>| -> Result<f64> {
        let Some(value) = cards.get(key) else { return default.with_context(|| format!("{key} is missing")) };
        value.parse().with_context(|| format!("{key} = {value} is no number"))
    };
    ensure!(number("NAXIS", None)? == 2.0, "no image of two axes");
    let (width, height) = (number("NAXIS1", None)? as usize, number("NAXIS2", None)? as usize);
    let (scale, zero) = (number("BSCALE", Some(1.0))?, number("BZERO", Some(0.0))?);
    let bitpix = number("BITPIX", None)? as i32;
    let size = bitpix.unsigned_abs() as usize / 8;
    let data = data.get(..width * height * size).context("data are cut short")?;
    if (bitpix, scale, zero) == (16, 1.0, 32_768.0) {
        let counts = data.chunks_exact(2).map(|b| i16::from_be_bytes([b[0], b[1]]).cast_unsigned() ^ 0x8000);
        return Ok(Image { width, height, values: Values::Counts(counts.collect()) });
    }
    let value = |b: &[u8]| -> Result<f64> {
        Ok(match bitpix {
            8 => f64::from(b[0]),
            16 => f64::from(i16::from_be_bytes([b[0], b[1]])),
            32 => f64::from(i32::from_be_bytes(b.try_into()?)),
            -32 => f64::from(f32::from_be_bytes(b.try_into()?)),
            -64 => f64::from_be_bytes(b.try_into()?),
            _ => bail!("BITPIX {bitpix} is not known"),
        })
    };
    let floats =
        data.chunks_exact(size).map(|b| Ok((value(b)? * scale + zero) as f32)).collect::<Result<Vec<f32>>>()?;
    Ok(Image { width, height, values: Values::Floats(floats) })
}
