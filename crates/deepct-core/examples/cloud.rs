//! Generates a random cumulus, writes and reads its file, and isolates the clouds of a field.
//!
//!     cargo run --release --package deepct-core --example cloud

use deepct_core::cloud::{
    CumulusSettings, FieldSettings, IsolateSettings, cumulus, field, isolate,
};
use deepct_core::io::{Provenance, read_cloud, write_cloud};
use deepct_core::optics::extinction;

fn main() -> deepct_core::Result<()> {
    let seed = 3;
    let settings = CumulusSettings { width_km: Some(0.8), ..CumulusSettings::default() };
    let cloud = cumulus(&settings, seed)?;
    let most = extinction(&cloud)?.values.iter().copied().fold(0.0, f32::max);
    println!("a cumulus of extinction up to {most:.0} km-1 on {:?} voxels", cloud.grid.shape);

    // The file can be opened by any netCDF-4 software, such as xarray, ncdump or Panoply.
    let path = std::env::temp_dir().join(format!("deepct-example-{}.nc", std::process::id()));
    let configuration = format!("width_km = {:?}", settings.width_km.unwrap_or_default());
    write_cloud(
        &path,
        &cloud,
        &Provenance { title: "A cumulus".into(), configuration, seed, ..Provenance::default() },
    )?;
    assert_eq!(read_cloud(&path)?, cloud);
    std::fs::remove_file(&path).map_err(deepct_core::Error::io(&path))?;

    let field = field(&FieldSettings::default(), seed)?;
    let clouds = isolate(&field, &IsolateSettings::default())?;
    println!(
        "a field of {} clouds that fit into 32 x 32 columns, the largest first:",
        clouds.len()
    );
    let mut columns: Vec<_> = clouds.iter().map(|isolated| isolated.columns).collect();
    columns.sort_by(|a, b| b.cmp(a));
    println!("columns: {:?}", &columns[..columns.len().min(10)]);
    Ok(())
}
