//! Tables of times of pictures.

use posebridge_vision::{PictureTime, parse_picture_times};
use proptest::prelude::*;

#[test]
fn a_table_of_times_is_read_and_an_error_names_its_line() {
    let row = |file: &str, time_s| PictureTime { file: file.to_owned(), time_s };
    let expected = [row("a.png", -0.5), row("b, c.png", 0.25), row("d.png", 0.25)];
    for text in [
        "file,time_s\na.png,-0.5\n\"b, c.png\",0.25\nd.png,2.5e-1\n",
        "\u{feff}Time_s , exposure, FileName\r\n# by hand\r\n-0.5,1,a.png\r\n\r\n0.25,,\"b, c.png\"\r\n0.25,2, d.png",
    ] {
        assert_eq!(parse_picture_times(text).unwrap(), expected);
    }
    assert_eq!(parse_picture_times("image,seconds\n").unwrap(), []);
    for (text, words) in [
        ("", "line 1: the header needs the columns `file` and `time_s`"),
        ("# times\nfile,timestamp\na,1\n", "line 2: the header needs"),
        ("file;time_s\na;1\n", "line 1: the header needs"),
        ("file,time_s\na,1\nb,x\n", "line 3: `x` is no time in seconds"),
        ("file,time_s\na,nan\n", "line 2: `nan` is no time"),
        ("file,time_s\na,1\n\n,2\n", "line 4: the name of the file is empty"),
        ("file,time_s\na,2\nb,1\n", "line 3: 1 s is before the time of `a`, 2 s"),
        ("file,time_s\na,2\n\nb\n", "line 4: it has 1 cells, the header has 2"),
    ] {
        let error = parse_picture_times(text).unwrap_err().to_string();
        assert!(error.starts_with(words), "{error}, not `{words}`");
    }
}

proptest! {
    #[test]
    fn no_table_is_too_wild(text in "(file|time_s|[,\"#\n\r0-9.e-]|\\PC){0,60}") {
        if let Ok(times) = parse_picture_times(&text) {
            prop_assert!(times.is_sorted_by(|one, next| one.time_s <= next.time_s));
        }
    }
}
