#![no_main]
//! Arrays of NumPy, MATLAB, pickles, Mitsuba and VTK: arbitrary bytes after the signature of a format give
//! a cloud, whose values are finite, or an error.

use deepct_core::io::import::{ImportSettings, read_les};

libfuzzer_sys::fuzz_target!(|input: (u8, &[u8])| {
    let matlab = format!("{:124}\0\u{1}IM", "MATLAB 5.0 MAT-file, written by deepct");
    let starts: [&[u8]; 6] =
        [b"\x93NUMPY\x01\0", b"PK\x03\x04", matlab.as_bytes(), b"\x80\x04", b"VOL\x03", b"<VTKFile"];
    let bytes = [starts[usize::from(input.0) % starts.len()], input.1].concat();
    let settings = ImportSettings {
        variable: Some("a".into()),
        axes: "z,y,x".parse().ok(),
        ..ImportSettings::default()
    };
    deepct_fuzz::with_file(&bytes, ".arrays", |path| {
        if let Ok((cloud, _)) = read_les(path, &settings) {
            deepct_fuzz::check_cloud(&cloud);
        }
    });
});
