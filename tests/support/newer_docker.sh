#!/bin/bash
# Unpacks Docker 26 of Debian's next release into a folder: newer_docker.sh FOLDER. Installs nothing. The runtime is the
# one of this machine, because theirs needs a newer libc.
set -euo pipefail
mkdir -p "$1"
cd "$1"
[ -e complete ] && exit
mkdir -p lists/partial cache/archives/partial sources
# The mirror that this machine uses, for the next release.
mirror=$(find /etc/apt -name '*.list' -o -name '*.sources' | xargs cat |
  sed -n 's/^deb \(\[[^]]*\] \)\?\([^ ]*\/debian\)\/\? .*/\2/p; s/^URIs: *\([^ ]*\/debian\)\/\?$/\1/p' | head -1)
cat >sources/next.sources <<END
Types: deb
URIs: ${mirror:?no mirror of Debian is known here}
Suites: trixie
Components: main
Signed-By: /usr/share/keyrings/debian-archive-keyring.gpg
END
cat >apt.conf <<END
Dir::Etc::sourcelist "/dev/null";
Dir::Etc::sourceparts "$PWD/sources";
Dir::State::lists "$PWD/lists";
Dir::Cache "$PWD/cache";
APT::Sandbox::User "root";
END
export APT_CONFIG="$PWD/apt.conf"
apt-get update -qq
apt-get download -qq docker.io containerd tini
for package in *.deb; do dpkg -x "$package" .; done
rm -rf *.deb lists cache
touch complete
