use crate::program::Program;
use deepct_core::io::{read_cloud, read_volume};
use deepct_core::metrics::relative_error;
use deepct_core::optics::extinction;

#[test]
fn the_main_job_with_nothing_else_given() {
    let program = Program::new();
    let table = program.succeed("demo");
    let folder = program.path("deepct-demo");
    for picture in ["images.png", "cloud.png"] {
        let bytes = std::fs::read(folder.join(picture)).unwrap();
        assert!(bytes.starts_with(b"\x89PNG"), "{picture}");
    }
    let truth = extinction(&read_cloud(folder.join("cloud.nc")).unwrap()).unwrap();
    let estimate = read_volume(folder.join("estimate.nc")).unwrap();
    let epsilon = relative_error(&truth, &estimate).unwrap();
    // An estimate of zero everywhere has an error of 1. The network must have a smaller error on a
    // cloud from a different source than its training data.
    assert!(epsilon < 0.9, "{epsilon}");
    assert!(table.contains(&format!("{epsilon:.3}")), "{epsilon} is not in: {table}");
}

#[test]
fn a_folder_that_cannot_be_made_is_refused() {
    let program = Program::new();
    std::fs::write(program.path("taken"), "a file").unwrap();
    program.refuse("demo --out taken", &["taken", "exists"]);
}
