//! The records of a telemetry log, each with its frame verified.

use anyhow::Result;
use posebridge_protocol::framing::{VerifiedFrame, verify};
use posebridge_recording::tlog::{FrameCheck, TlogReader, TlogRecord};

use crate::console::progress_bar;
use crate::station::input_file::InputFile;

/// Gives every record of a file whose frame is whole or of an unknown message, and then the reader, which has counted.
///
/// # Errors
/// The file cannot be read any further; what came before was given.
pub fn records(mut file: InputFile, mut take: impl FnMut(TlogRecord<'_, ()>)) -> Result<TlogReader> {
    let mut reader = TlogReader::new();
    let bar = progress_bar(file.size, "bytes")?;
    file.chunks(|chunk| {
        reader.push(chunk, &mut classify, &mut take);
        bar.inc(chunk.len() as u64);
    })?;
    reader.finish(&mut classify, &mut take);
    bar.finish_and_clear();
    file.warn_if_truncated();
    Ok(reader)
}

/// Gives the first records of a file for as long as more are wanted.
///
/// # Errors
/// As [`records`].
pub fn first_records(mut file: InputFile, mut wants_more: impl FnMut(TlogRecord<'_, ()>) -> bool) -> Result<()> {
    let mut reader = TlogReader::new();
    let mut is_wanted = true;
    file.chunks_while(|chunk| {
        reader.push(chunk, &mut classify, &mut |record| {
            is_wanted = is_wanted && wants_more(record);
        });
        is_wanted
    })?;
    reader.finish(&mut classify, &mut |record| {
        is_wanted = is_wanted && wants_more(record);
    });
    Ok(())
}

/// The checksum status of a record's frame.
fn classify(raw: &[u8]) -> FrameCheck<()> {
    match verify(raw) {
        VerifiedFrame::Frame(_) => FrameCheck::Valid(()),
        VerifiedFrame::UnknownFrame(_) => FrameCheck::Unknown(()),
        VerifiedFrame::Invalid => FrameCheck::Invalid,
    }
}
