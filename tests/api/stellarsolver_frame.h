// What the programs around StellarSolver, Ekos' library, share: the image that it is given.
#pragma once

#include <QByteArray>
#include <QFile>
#include <QString>

#include <stellarsolver.h>

// 16-bit pixels of this machine's byte order, the first row first, and how the library describes them.
struct RawFrame
{
    QByteArray pixels;
    FITSImage::Statistic image;

    bool read(const char *path, const char *width, const char *height)
    {
        QFile file(QString::fromUtf8(path));
        if (!file.open(QIODevice::ReadOnly))
            return false;
        pixels = file.readAll();
        image.width = QString(width).toInt();
        image.height = QString(height).toInt();
        image.samples_per_channel = uint32_t(image.width) * image.height;
        image.bytesPerPixel = 2;
        image.dataType = 20; // TUSHORT
        image.size = pixels.size();
        return true;
    }

    const uint8_t *data() const
    {
        return reinterpret_cast<const uint8_t *>(pixels.constData());
    }
};
