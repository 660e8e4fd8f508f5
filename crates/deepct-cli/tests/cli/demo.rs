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
    // 0.432 for this cloud, which is not of the simulation that the network was trained with.
    assert!(epsilon < 0.47, "{epsilon}");
    assert!(table.contains(&format!("{epsilon:.3}")), "{epsilon} is not in: {table}");
}

#[test]
fn a_folder_that_cannot_be_made_is_refused() {
    let program = Program::new();
    std::fs::write(program.path("taken"), "a file").unwrap();
    program.refuse("demo --out taken", &["taken", "exists"]);
}
