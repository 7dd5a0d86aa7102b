//! The `holovol` command; all of it is in the library beside.

fn main() -> std::process::ExitCode {
    holovol::main()
}
