#!/bin/sh
# Debian's Chromium and its driver for the tests of the site, where this user may install them. Never asks, never fails,
# never takes long: without them those tests are skipped.
set -u

have() {
    command -v "$1" >/dev/null 2>&1
}

skip() {
    echo "no Chromium for the tests of the site ($1); they will be skipped"
    exit 0
}

if [ -n "${CHROMIUM:-}" ] || { have chromium && have chromedriver; }; then
    exit 0
fi
have apt-get && have timeout || skip "it is not here, and there is no apt-get to install it with"
as_root=""
if [ "$(id -u)" != 0 ]; then
    { have sudo && sudo -n true 2>/dev/null; } || skip "it is not here; install the packages chromium and chromium-driver"
    as_root="sudo -n"
fi

# Only what fetches is cut short: packages that are being unpacked must not be left half installed.
apt() {
    limit=$1
    shift
    $as_root timeout -k 5 "$limit" env DEBIAN_FRONTEND=noninteractive apt-get -qq -y -o Acquire::Retries=0 \
        -o Acquire::http::Timeout=10 -o Acquire::https::Timeout=10 -o DPkg::Lock::Timeout=30 "$@" </dev/null >/dev/null 2>&1
}

set -- --no-install-recommends chromium chromium-driver
# Without a network this is what fails, and soon.
apt 60 update -o APT::Update::Error-Mode=any || skip "apt-get update did not work, is there a network?"
apt 240 install --download-only "$@" || skip "apt-get could not fetch the packages chromium and chromium-driver"
apt 600 install --no-download "$@" || skip "apt-get could not install the packages chromium and chromium-driver"
echo "installed Debian's chromium and chromium-driver for the tests of the site"
