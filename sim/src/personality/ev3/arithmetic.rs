//! The byte codes that move, calculate and jump: as much as clients put into direct commands.
//!
//! ```text
//! 10..1F   add, subtract, multiply, divide    for each width        30..3F   move from a width to a width
//! 40..42   jump, if false, if true            64..7B   jump if <, >, =, !=, <=, >= for each width        8D 06   absolute value
//! ```
//! # Sources
//! LEGO MINDSTORMS EV3 firmware developer kit, byte codes.

use super::machine::{BytecodeMachine, ExecutionFault, OperandWidth};

/// A value as it was loaded.
enum Number {
    Whole(i32),
    Real(f32),
}

/// Follows a byte code of these kinds; `None` if it is of another kind.
pub(super) fn calculate(code: u8, machine: &mut BytecodeMachine) -> Option<Result<(), ExecutionFault>> {
    match code {
        0x10..=0x1F => Some(combine((code - 0x10) >> 2, OperandWidth::of(code), machine)),
        0x30..=0x3F => Some(convert(OperandWidth::of((code - 0x30) >> 2), OperandWidth::of(code), machine)),
        0x40..=0x42 => Some(jump(code, machine)),
        0x64..=0x7B => Some(jump_compared((code - 0x64) >> 2, OperandWidth::of(code), machine)),
        _ => None,
    }
}

/// MATH: the absolute value alone.
pub(super) fn math(machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    const ABSOLUTE: i32 = 6;
    if machine.byte()? != ABSOLUTE {
        return Err(ExecutionFault);
    }
    let value = machine.real()?;
    machine.write_real(value.abs())
}

fn load(width: OperandWidth, machine: &mut BytecodeMachine) -> Result<Number, ExecutionFault> {
    if width == OperandWidth::Real { machine.real().map(Number::Real) } else { machine.int(width).map(Number::Whole) }
}

fn combine(operation: u8, width: OperandWidth, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    match (load(width, machine)?, load(width, machine)?) {
        (Number::Real(a), Number::Real(b)) => machine.write_real(match operation {
            0 => a + b,
            1 => a - b,
            2 => a * b,
            _ => a / b,
        }),
        (Number::Whole(a), Number::Whole(b)) => {
            let result = match operation {
                0 => a.wrapping_add(b),
                1 => a.wrapping_sub(b),
                2 => a.wrapping_mul(b),
                _ => a.checked_div(b).unwrap_or(0),
            };
            machine.write_int(width, result)
        }
        (Number::Real(_), Number::Whole(_)) | (Number::Whole(_), Number::Real(_)) => Err(ExecutionFault),
    }
}

fn convert(from: OperandWidth, to: OperandWidth, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    match (load(from, machine)?, to) {
        (Number::Whole(value), OperandWidth::Real) => machine.write_real(value as f32),
        (Number::Whole(value), _) => machine.write_int(to, value),
        (Number::Real(value), OperandWidth::Real) => machine.write_real(value),
        (Number::Real(value), OperandWidth::Byte) => machine.write_int(to, i32::from(value as i8)),
        (Number::Real(value), OperandWidth::Word) => machine.write_int(to, i32::from(value as i16)),
        (Number::Real(value), OperandWidth::Long) => machine.write_int(to, value as i32),
    }
}

fn jump(code: u8, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    let is_taken = match code {
        0x40 => true,
        0x41 => machine.byte()? == 0,
        _ => machine.byte()? != 0,
    };
    let by = machine.int(OperandWidth::Long)?;
    if is_taken { machine.jump(by) } else { Ok(()) }
}

fn jump_compared(comparison: u8, width: OperandWidth, machine: &mut BytecodeMachine) -> Result<(), ExecutionFault> {
    let order = match (load(width, machine)?, load(width, machine)?) {
        (Number::Real(a), Number::Real(b)) => a.partial_cmp(&b),
        (Number::Whole(a), Number::Whole(b)) => Some(a.cmp(&b)),
        (Number::Real(_), Number::Whole(_)) | (Number::Whole(_), Number::Real(_)) => None,
    };
    let is_taken = order.is_some_and(|order| match comparison {
        0 => order.is_lt(),
        1 => order.is_gt(),
        2 => order.is_eq(),
        3 => order.is_ne(),
        4 => order.is_le(),
        _ => order.is_ge(),
    });
    let by = machine.int(OperandWidth::Long)?;
    if is_taken { machine.jump(by) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs codes to their end and returns the global memory.
    fn run(code: &[u8]) -> Vec<u8> {
        let mut machine = BytecodeMachine::new(code, 8, 8);
        while let Some(code) = machine.next_code() {
            calculate(code, &mut machine).unwrap().unwrap();
        }
        machine.globals().to_vec()
    }

    #[test]
    fn numbers_are_added_moved_and_compared() {
        // 40 + -2 as bytes; the sum as a real number.
        let memory = run(&[0x10, 0x81, 40, 0x3E, 0x60, 0x33, 0x60, 0x64]);
        assert_eq!(memory[0], 38);
        assert_eq!(memory[4..], 38.0_f32.to_le_bytes());
        // 7 / 2 and 7 / 0 as longs.
        assert_eq!(run(&[0x1E, 7, 2, 0x60, 0x1E, 7, 0, 0x64]), [3, 0, 0, 0, 0, 0, 0, 0]);
        // 5 >= 4: the move is jumped over.
        assert_eq!(run(&[0x7A, 5, 4, 3, 0x30, 9, 0x60])[0], 0);
        assert_eq!(run(&[0x7A, 3, 4, 3, 0x30, 9, 0x60])[0], 9);
        assert_eq!(run(&[0x41, 0, 3, 0x30, 9, 0x60])[0], 0);
    }

    #[test]
    fn a_real_number_is_cut_to_a_whole_one() {
        // 7 as a real number, halved, as a byte.
        let memory = run(&[0x33, 7, 0x40, 0x33, 2, 0x44, 0x1F, 0x40, 0x44, 0x40, 0x3C, 0x40, 0x60]);
        assert_eq!(memory[0], 3);
    }
}
