//! Binary tables: their content, and that no bytes make the reader panic.
#![allow(clippy::unwrap_used, clippy::panic)]
#![allow(missing_docs)]

use std::path::{Path, PathBuf};

use fits::Table;
use tempfile::TempDir;

/// Three rows of text, a scaled integer with a null, a truth, an array that is passed over, and a double.
fn table() -> Vec<u8> {
    let mut bytes = Vec::new();
    let primary =
        ["SIMPLE  =                    T", "BITPIX  =                    8", "NAXIS   =                    0"];
    let image = [
        "XTENSION= 'IMAGE   '",
        "BITPIX  =                   16",
        "NAXIS   =                    2",
        "NAXIS1  =                    3",
        "NAXIS2  =                    2",
    ];
    let table = [
        "XTENSION= 'BINTABLE'",
        "BITPIX  =                    8",
        "NAXIS   =                    2",
        "NAXIS1  =                   28",
        "NAXIS2  =                    3",
        "PCOUNT  =                    0",
        "GCOUNT  =                    1",
        "TFIELDS =                    5",
        "TTYPE1  = 'NAME    '",
        "TFORM1  = '5A      '",
        "TTYPE2  = 'RA      '",
        "TFORM2  = 'J       '",
        "TSCAL2  =                1E-07",
        "TZERO2  =                180.0",
        "TNULL2  =                   -1",
        "TUNIT2  = 'deg     '",
        "TTYPE3  = 'GAIA    '",
        "TFORM3  = 'L       '",
        "TTYPE4  = 'COVAR   '",
        "TFORM4  = '10B     '",
        "TTYPE5  = 'MAG     '",
        "TFORM5  = '1D      '",
    ];
    for (cards, data) in [(&primary[..], 0), (&image[..], 12), (&table[..], 0)] {
        cards.iter().chain([&"END"]).for_each(|card| bytes.extend(format!("{card:80}").bytes()));
        bytes.resize(bytes.len().div_ceil(2880) * 2880, b' ');
        bytes.extend(vec![0; usize::div_ceil(data, 2880) * 2880]);
    }
    for (ra, gaia, mag) in [(-1_800_000_000_i32, b'T', 4.5), (-1, b'F', f64::NAN), (5, 0, -1.46)] {
        bytes.extend(b"Vega ");
        bytes.extend(ra.to_be_bytes());
        bytes.push(gaia);
        bytes.extend([7; 10]);
        bytes.extend(mag.to_be_bytes());
    }
    bytes.resize(bytes.len().div_ceil(2880) * 2880, 0);
    bytes
}

fn written(folder: &TempDir, bytes: &[u8]) -> PathBuf {
    let file = folder.path().join("stars.fits");
    std::fs::write(&file, bytes).unwrap();
    file
}

#[test]
fn cells_are_scaled_and_unknown_ones_are_none() {
    let folder = TempDir::new().unwrap();
    let mut table = Table::open(&written(&folder, &table())).unwrap();
    assert_eq!(table.rows(), 3);
    let names: Vec<&str> = table.columns().iter().map(|column| column.name.as_str()).collect();
    assert_eq!(names, ["RA", "GAIA", "MAG"], "text and arrays are passed over");
    assert_eq!(table.column("ra").unwrap().unit.as_deref(), Some("deg"));
    let columns = table.columns().to_vec();
    let mut rows = Vec::new();
    while let Some(row) = table.next_row().unwrap() {
        rows.push(columns.iter().map(|column| column.value(row)).collect::<Vec<_>>());
    }
    assert_eq!(rows[0], [Some(0.0), Some(1.0), Some(4.5)]);
    assert_eq!(rows[1], [None, Some(0.0), None]);
    let ra = rows[2][0].unwrap();
    assert!((ra - 180.000_000_5).abs() < 1e-12 && rows[2][1].is_none() && rows[2][2] == Some(-1.46), "{rows:?}");
}

/// Reads all of a table; the error, if there is one.
fn read(file: &Path) -> Result<u64, String> {
    let mut table = Table::open(file).map_err(|error| error.to_string())?;
    let columns = table.columns().to_vec();
    let mut count = 0;
    while let Some(row) = table.next_row().map_err(|error| error.to_string())? {
        assert!(columns.iter().filter_map(|column| column.value(row)).all(f64::is_finite));
        count += 1;
    }
    Ok(count)
}

#[test]
fn a_table_that_is_cut_short_or_not_there_is_reported() {
    let folder = TempDir::new().unwrap();
    let whole = table();
    let end = whole.len() - 2880;
    for (bytes, words) in [
        (&whole[..end + 60], "its table ends in row 3 of 3"),
        (&whole[..end - 100], "is cut short: HDU 3"),
        (&whole[..4 * 2880 - 2880], "holds no binary table, only an image, IMAGE"),
        (&b"ra,dec\n"[..], "is not FITS"),
        (&[], "is empty (0 bytes)"),
    ] {
        let message = read(&written(&folder, bytes)).unwrap_err();
        assert!(message.contains(words) && message.contains("stars.fits"), "{words:?} in {message:?}");
    }
    let mut wide = whole.clone();
    let form = wide.windows(8).position(|bytes| bytes == b"10B     ").unwrap();
    wide[form..form + 8].copy_from_slice(b"99B     ");
    assert!(read(&written(&folder, &wide)).unwrap_err().contains("TFORM4 = '99B' does not fit in a row"));
}

#[test]
fn no_change_of_a_byte_makes_it_panic() {
    let folder = TempDir::new().unwrap();
    let whole = table();
    let mut answers = [0; 2];
    // All bytes that contain lengths, types and forms.
    let form = |at: usize| whole[at].is_ascii_digit() || (at > 0 && whole[at - 1] == b'\'');
    for at in (0..whole.len()).filter(|at| form(*at)) {
        for with in [b'9', b' ', 0xFF] {
            let mut bytes = whole.clone();
            bytes[at] = with;
            answers[usize::from(read(&written(&folder, &bytes)).is_ok())] += 1;
        }
    }
    assert!(answers[0] > 20 && answers[1] > 20, "{answers:?}");
}
