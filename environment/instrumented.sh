# shellcheck shell=bash
# instrumented NAME CMAKE_ARGUMENT...: build the module with other flags in build/NAME/root, in a
# package of its own, which leaves the fast module in place, and let Python take it.
instrumented() {
  local project build=$1
  shift
  project=$(dirname "$(dirname "$(realpath "${BASH_SOURCE[0]}")")")
  cd "$project" || exit
  build=$project/build/$build
  mkdir -p "$build/root/dolfinx_nts"
  find "$project/dolfinx_nts" -mindepth 1 -maxdepth 1 ! -name '_kernels.*.so' ! -name __pycache__ \
    -exec ln -sfn -t "$build/root/dolfinx_nts" {} +
  {
    cmake -S "$project/dolfinx_nts/cpp" -B "$build" -G Ninja "$@" \
      -D CMAKE_BUILD_TYPE=Debug -D CMAKE_INSTALL_PREFIX="$build/root" \
      -D Python_EXECUTABLE="$(command -v python3)"
    cmake --build "$build" --target install
  } > "$build.log" 2>&1 || { cat "$build.log" >&2 && exit 1; }
  export PYTHONSAFEPATH=1 PYTHONPATH=$build/root:$PYTHONPATH
}

# Pytest without the project in front, whose fast module would be taken.
instrumented_pytest() { python3 -m pytest -p no:cacheprovider -o pythonpath=tests "$@"; }
