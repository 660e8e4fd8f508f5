use crate::plot::scene;
use crate::program::Program;

const START: &str = "<!DOCTYPE html>\n<!-- deepct -->";

fn page(program: &Program, name: &str) -> String {
    let text = std::fs::read_to_string(program.path(name)).unwrap();
    assert!(text.starts_with(START), "{name}");
    text
}

#[test]
fn files_and_folders_become_pages() {
    let program = Program::new();
    scene(&program);
    assert_eq!(program.succeed("view V.nc").trim(), "V.html");
    // The same command again replaces its own page.
    program.succeed("view V.nc");
    assert!(page(&program, "V.html").contains("\"shape\":[8,9,10]"));
    program.succeed("view V.nc --truth V.nc --out twins.html");
    assert!(page(&program, "twins.html").contains("<td>V.nc</td><td>0.0000</td><td>0.0000</td>"));
    program.succeed("view M.nc");
    assert!(page(&program, "M.html").contains("\"mask\":{"));
    program.succeed("view I.nc");
    let images = page(&program, "I.html");
    assert!(images.contains("data:image/png;base64,") && !images.contains("<script"));

    std::fs::write(program.path("damaged.nc"), "not an HDF5 file").unwrap();
    std::fs::copy(program.path("V.nc"), program.path("truth.nc")).unwrap();
    program.succeed("report .");
    let text = page(&program, "report.html");
    for part in
        ["<td>damaged.nc</td>", "<td>M.nc</td>", "<td>V.nc</td>", "truth (truth.nc)", "I.nc"]
    {
        assert!(text.contains(part), "{part}");
    }
}

#[test]
fn wrong_input_is_refused() {
    let program = Program::new();
    scene(&program);
    std::fs::write(program.path("own.html"), "my notes").unwrap();
    std::fs::create_dir(program.path("empty")).unwrap();
    program.refuse("view none.nc", &["none.nc"]);
    program.refuse("view V.nc --out a.txt", &["a.txt", ".html"]);
    program.refuse("view V.nc --out own.html", &["own.html", "--force"]);
    program.refuse("view V.nc --truth flat.nc", &["V.nc", "flat.nc", "regrid"]);
    program.refuse("view I.nc --truth V.nc", &["I.nc", "--truth"]);
    program.refuse("report empty", &["empty", ".nc"]);
    program.refuse("report none", &["none"]);
    program.refuse("report V.nc", &["V.nc: folder: is a file; give a folder, or show"]);
    assert_eq!(std::fs::read_to_string(program.path("own.html")).unwrap(), "my notes");
    assert!(!program.files().contains(&"V.html".to_owned()));
}
