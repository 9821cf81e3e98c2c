//! How an image is cut into tiles, and whether that can be (FITS Standard 4.0, section 10.1).
//!
//! cfitsio 3.49 divides by the values of these keywords and trusts them, so they are checked before cfitsio reads them.

use crate::hdu::Shape;
use crate::header::Header;

/// The ways of compressing that cfitsio knows.
const KNOWN: [&str; 7] = ["RICE_1", "RICE_ONE", "GZIP_1", "GZIP_2", "PLIO_1", "HCOMPRESS_1", "NOCOMPRESS"];

/// Pixels that a byte holds at most where the way of compressing has such a limit: deflate's 1032 bytes, and of Rice's
/// 32 pixels and more in 3 bits less than that.
const MOST_PIXELS: u64 = 1032;

/// Whether the table's rows are the tiles of an image of this shape, and its `bytes` enough for them. On failure: which
/// keyword, what was expected.
pub(crate) fn check(header: &Header, shape: &Shape, bytes: u64) -> Result<(), String> {
    let how = header.text("ZCMPTYPE").map_err(|error| error.to_string())?;
    if !KNOWN.contains(&how) {
        return Err(format!("ZCMPTYPE is '{how}', expected one of {}", KNOWN.join(", ")));
    }
    let pixels = shape.axes.iter().fold(1_u64, |product, length| product.saturating_mul(*length));
    if !matches!(how, "PLIO_1" | "HCOMPRESS_1") && pixels > bytes.saturating_mul(MOST_PIXELS) {
        return Err(format!("ZNAXISn announce {pixels} px, too many for {bytes} bytes of tiles"));
    }
    let mut tiles = 1_u64;
    for (n, length) in (1..).zip(&shape.axes) {
        let keyword = format!("ZTILE{n}");
        // Left out, a tile is a row.
        let side = or(header, &keyword, if n == 1 { (*length).cast_signed() } else { 1 })?;
        let side = u64::try_from(side).ok().filter(|side| (1..=*length).contains(side));
        let side = side.ok_or_else(|| format!("{keyword} is no length up to {length}"))?;
        tiles = tiles.saturating_mul(length.div_ceil(side));
    }
    let rows = header.whole("NAXIS2").map_err(|error| error.to_string())?;
    if u64::try_from(rows) != Ok(tiles) {
        return Err(format!("NAXIS2 is {rows}, expected {tiles} tiles"));
    }
    for n in 1..=9 {
        let (name, value) = (format!("ZNAME{n}"), format!("ZVAL{n}"));
        let allowed: &[i64] = match header.text(&name) {
            Ok("BLOCKSIZE") => &[16, 32],
            Ok("BYTEPIX") => &[1, 2, 4, 8],
            Ok("SMOOTH") => &[0, 1],
            _ => continue,
        };
        let value = header.whole(&value).map_err(|error| error.to_string())?;
        if !allowed.contains(&value) {
            return Err(format!("ZVAL{n} is {value}, expected one of {allowed:?}"));
        }
    }
    Ok(())
}

fn or(header: &Header, keyword: &str, default: i64) -> Result<i64, String> {
    match header.value(keyword) {
        None => Ok(default),
        Some(_) => header.whole(keyword).map_err(|error| error.to_string()),
    }
}
